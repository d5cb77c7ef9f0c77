"""Every setting of the service, read once from the environment."""

import ipaddress
from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr
from pydantic_settings import BaseSettings, SettingsConfigDict

from app.logs import LogFormat

__all__ = ["Settings", "is_loopback"]


class Settings(BaseSettings):
    """What an operator may choose; `TENSORMAP_` and the upper-case name is the variable."""

    model_config = SettingsConfigDict(
        env_prefix="TENSORMAP_",
        frozen=True,
        hide_input_in_errors=True,  # it may be a key
    )

    host: str = Field("127.0.0.1", description="Address to listen on.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 takes a free one.")
    data_dir: Path = Field(Path("data"), description="Where maps and the catalog are kept.")
    catalog_url: str | None = Field(
        None, description="SQLAlchemy URL of the catalog; SQLite in the data directory by default."
    )
    admin_key: SecretStr | None = Field(
        None, min_length=16, description="The administrator's key; asked of every caller if set."
    )
    max_body_bytes: int = Field(
        64 * 2**20, ge=2**10, description="The largest request body that is read."
    )
    max_json_bytes: int = Field(
        4 * 2**20,
        ge=2**10,
        description="The largest JSON body that is read: it is parsed whole, scans are not.",
    )
    log_format: LogFormat = Field(
        LogFormat.TEXT, description="How a line of the log is written: `text` or `json`."
    )
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = Field(
        "INFO", description="What is logged; a line for each request at `INFO`."
    )
    min_returns: int = Field(
        100, ge=1, description="A scan with fewer finite, non-zero returns is refused."
    )
    build_workers: int = Field(1, ge=1, le=64, description="How many builds run at once.")
    loaded_revisions: int = Field(
        8, ge=1, description="How many revisions are kept in memory to answer queries."
    )
    max_tracks: int = Field(
        1000, ge=1, description="How many vehicles are tracked at once; another is refused."
    )
    track_idle_s: float = Field(
        600.0, gt=0.0, description="How many seconds after its last use a track is forgotten."
    )


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback
