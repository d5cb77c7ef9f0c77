"""Every setting of the service, read once from the environment."""

import ipaddress
import re
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from storage.retention import LONGEST_DAYS, MOST_REVISIONS, RawScans, Retention

ADMIN_KEY = "TENSORMAP_ADMIN_KEY"
"""The variable of the administrator's key."""

_ORIGIN = re.compile(r"https?://([a-z0-9.-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?")
_PREFIX = re.compile(r"(/[A-Za-z0-9][A-Za-z0-9_~.-]*)+")
_OWN_PATHS = re.compile(
    r"/(v1|docs|static-offline-docs|openapi\.json|problems|version|livez|readyz|metrics)(/.*)?"
)
_BRACKETS = re.compile(r"\[([0-9A-Fa-f]*:[0-9A-Fa-f:.]*)\]")
_LEAST_BUILD_BYTES = 256 * 2**20  # with less every build fails, as with a number of megabytes
_LEAST_KEY_CHARACTERS = 16
_MOST_BYTES = 2**63 - 1  # what the system's calls take

Count = Annotated[int, Field(ge=1)]
Kilobytes = Annotated[int, Field(ge=2**10, le=_MOST_BYTES)]
AtLeast0 = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Above0 = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class LogFormat(StrEnum):
    """Format of a line of the log."""

    TEXT = "text"
    JSON = "json"


def _not_empty(given: object) -> object:
    if given == "":  # of an unset variable: all addresses, or the current folder
        raise ValueError("it is empty, wanted a value, or no such variable")
    return given


def _host(given: str) -> str:
    in_brackets = _BRACKETS.fullmatch(given)  # as of a URL
    return in_brackets[1] if in_brackets else given


def _origin(given: str) -> str:
    if _ORIGIN.fullmatch(given) is None:
        raise ValueError(
            "wanted origins as a browser sends them, `https://maps.example` or"
            " `http://127.0.0.1:3000`, lower case, without a path and without `*`"
        )
    return given


def _path_prefix(given: str) -> str:
    if given and _PREFIX.fullmatch(given) is None:
        raise ValueError(
            "wanted a path, for example `/tensormap`, of letters, digits, `-`, `_`, `.` and `~`,"
            " without `/` at its end"
        )
    if _OWN_PATHS.fullmatch(given) is not None:
        raise ValueError(f"{given} is a path of the service, wanted another one")
    return given


def _network(given: str) -> str:
    try:
        ipaddress.ip_network(given)
    except ValueError:
        raise ValueError(
            "wanted addresses or networks, for example `127.0.0.1` or `10.0.0.0/8`, without names"
            " and without `*`"
        ) from None
    return given


def _build_memory(given: int) -> int:
    if 0 < given < _LEAST_BUILD_BYTES:
        raise ValueError(f"wanted 0, for no limit, or at least {_LEAST_BUILD_BYTES} bytes")
    return given


def _key(given: SecretStr) -> SecretStr:
    if len(given) < _LEAST_KEY_CHARACTERS:
        raise ValueError(f"wanted at least {_LEAST_KEY_CHARACTERS} characters, got {len(given)}")
    key = given.get_secret_value()
    if not (key.isascii() and key.isprintable() and key == key.strip()):  # no header would have it
        raise ValueError("wanted printable ASCII, without a blank at the beginning or the end")
    return given


class Settings(BaseSettings):
    """The settings; `TENSORMAP_` and the upper-case name is the variable."""

    model_config = SettingsConfigDict(
        env_prefix="TENSORMAP_",
        frozen=True,
        hide_input_in_errors=True,  # it may be a key
    )

    host: Annotated[str, BeforeValidator(_not_empty), AfterValidator(_host)] = "127.0.0.1"
    """Address to listen on."""
    port: int = Field(8000, ge=0, le=65535)
    """Port to listen on; 0 takes a free one."""
    data_dir: Annotated[Path, BeforeValidator(_not_empty)] = Path("data")
    """Where maps and the catalog are kept."""
    catalog_url: Annotated[str | None, AfterValidator(lambda given: given or None)] = None
    """SQLAlchemy URL of the catalog; SQLite in the data directory by default."""
    admin_key: Annotated[SecretStr, AfterValidator(_key)] | None = None
    """The administrator's key; every request needs a key if this is set. At least 16 characters; 32
    random bytes are recommended, as `openssl rand -hex 32` prints them."""
    max_body_bytes: Kilobytes = 64 * 2**20
    """The largest request body, as a scan or a map file; JSON and many scans have other limits."""
    max_decoded_bytes: Kilobytes = 256 * 2**20
    """The largest compressed request body after decompression."""
    max_upload_bytes: Kilobytes = 64 * 2**30
    """The largest body of many scans, unpacked; each scan in it may have
    TENSORMAP_MAX_BODY_BYTES."""
    max_capture_bytes_per_key: Kilobytes = 128 * 2**30
    """How many bytes of captures that are uploaded in parts, and not read yet, a key may have; a
    single one has at most TENSORMAP_MAX_UPLOAD_BYTES, and its returns as well."""
    capture_hours: Above0 = Field(72.0, le=LONGEST_DAYS * 24.0)
    """How many hours after its last part, or after its job, a capture is deleted; scans that it
    became stay."""
    capture_read_s: Above0 = 21_600.0
    """How many seconds it may take to read a capture; one that takes longer fails."""
    max_json_bytes: Kilobytes = 4 * 2**20
    """The largest JSON body that is read: it is parsed whole, scans are not."""
    body_idle_s: Above0 = 20.0
    """How many seconds nothing of a request body may arrive; then it is rejected."""
    body_bytes_per_s: AtLeast0 = 256.0
    """The minimum rate of a request body; 0 for none. The total time is not limited."""
    body_grace_s: Above0 = 30.0
    """How many seconds a request body may lag behind TENSORMAP_BODY_BYTES_PER_S."""
    bodies_per_key: Count = 512
    """How many request bodies of one key are read at once."""
    max_spool_bytes: int = Field(96 * 2**30, ge=2**20, le=_MOST_BYTES)
    """How many bytes of incomplete request bodies are kept, in memory or in files of the data
    directory; three quarters of that for one key."""
    heavy_threads: Count = Field(6, le=256)
    """How many long requests run at once: scans, archives, closures, imports, comparisons, large
    JSON."""
    heavy_threads_per_key: Count = 2
    """How many of these of one key run at once; others of it wait."""
    short_threads: int = Field(32, ge=2, le=256)
    """How many other requests run at once; 3/4 of one key."""
    queued_requests: Count = 1024
    """How many requests wait for a thread of each kind, half of them of one key; more are rejected.
    Waiting keys take turns."""
    log_format: LogFormat = LogFormat.TEXT
    """The format of a log line: `text` or `json`."""
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"
    """The least level that is logged; a line for each request at `INFO`."""
    min_returns: Count = 100
    """A scan with fewer finite, non-zero returns is rejected."""
    build_workers: Count = Field(1, le=64)
    """How many jobs run at once: builds, and captures that are read."""
    max_queued_builds_per_key: Count = 50
    """How many jobs a key may have in the queue; another is rejected."""
    build_stall_s: Above0 = 3600.0
    """How many seconds a job may make no progress; then its process is ended, and it fails."""
    build_memory_bytes: (
        Annotated[int, Field(ge=0, le=_MOST_BYTES), AfterValidator(_build_memory)] | None
    ) = None
    """How many bytes a job may allocate; one that needs more fails. By default
    `TENSORMAP_BUILD_WORKERS` jobs share three quarters of the machine's, or the control group's,
    memory; 0 limits nothing, and less than 256 MiB is rejected."""
    loaded_revisions: Count = 8
    """How many revisions are kept in memory to answer queries; those of running tracks are kept
    besides."""
    max_maps_opened: Count = 64
    """How many maps a query that names no map may open; those of one shared basis are one index, of
    which few are opened. A query that would need more is rejected."""
    opened_scans: Count = 64_000
    """How many scans the maps have, all together, that stay in memory for queries that name no map,
    besides TENSORMAP_LOADED_REVISIONS. Each takes some 20 kB with the default ranks, 1.3 GB in all,
    and more with larger ones, 45 kB with 6 x 32. Maps for which no room is left are read from disk
    by each such query."""
    retained_revisions: Annotated[int, Field(ge=0, le=MOST_REVISIONS)] | Literal["all"] = "all"
    """How many revisions of a map are kept besides the live and the newest one, or `all`; a map may
    choose otherwise."""
    retained_for_days: AtLeast0 = Field(30.0, le=LONGEST_DAYS)
    """How long any revision is kept after it was built or, if it was live, replaced; a map may
    choose otherwise."""
    raw_scans: RawScans = RawScans.KEEP
    """`drop` removes the returns of closed drives that the live revision was built of; a map may
    choose otherwise."""
    recycle_bin_days: AtLeast0 = Field(7.0, le=LONGEST_DAYS)
    """How many days deleted maps and drives can be restored; then they are removed. 0 removes them
    at once."""
    max_tracks: Count = 1000
    """How many vehicles are tracked at once; another is rejected."""
    max_tracks_per_key: Count = 500
    """How many tracks of one key are kept at once; another is rejected."""
    tracked_revisions: Count = 32
    """How many revisions are kept in memory for running tracks. For another one, the tracks of that
    used longest ago are saved; they go on at their next observation."""
    track_idle_s: Above0 = 600.0
    """How many seconds after its last use a track is deleted."""
    max_connections: int = Field(0, ge=0)
    """How many connections are open at once; an idle one is closed for another. 0 takes as many as
    the descriptors allow, at most 4096."""
    request_head_s: Above0 = 10.0
    """How many seconds a request's head may take, from the start of its connection or from its
    first byte; then the connection is closed."""
    max_streams: Count = 2000
    """How many streams, of tracks and of jobs' events, are open at once; another is rejected.
    `serve` takes half of TENSORMAP_MAX_CONNECTIONS if that is less."""
    max_streams_per_key: Count = 1000
    """How many streams of one key are open at once; another is rejected. `serve` takes half of all
    streams if that is less."""
    stream_idle_s: Above0 = 600.0
    """How many seconds after its last message the stream of a track is closed."""
    max_tokens_per_key: Count = 100
    """How many valid tokens a key may have; another is rejected until one expires."""
    requests_per_s: AtLeast0 = 0.0
    """How many requests a second a key may make on average; 0 limits nothing."""
    request_burst: Count = 50
    """How many requests a key that was idle may make at once."""
    upload_bytes_per_day: int = Field(0, ge=0, le=_MOST_BYTES)
    """How many bytes a key may send in a day, of bodies, counted on the wire, and of a stream's
    messages; 0 limits nothing. A key that was idle for a day has all of them again, and so has each
    key after a start of the service."""
    allowed_origins: Annotated[tuple[Annotated[str, AfterValidator(_origin)], ...], NoDecode] = ()
    """Origins of other sites whose pages may send requests, for example `https://maps.example`,
    separated by commas; none by default."""
    trusted_proxies: Annotated[tuple[Annotated[str, AfterValidator(_network)], ...], NoDecode] = ()
    """Addresses or networks of reverse proxies whose `X-Forwarded-For` and `X-Forwarded-Proto` are
    trusted, for example `127.0.0.1`, separated by commas; none by default."""
    path_prefix: Annotated[str, AfterValidator(_path_prefix)] = ""
    """The path under which a proxy passes requests on, for example `/tensormap`, where other
    services share the host; the proxy may remove it or not. By default there is none."""
    scrub_days: AtLeast0 = Field(30.0, le=LONGEST_DAYS)
    """Within how many days every stored file is read and checked once; 0 checks none."""

    @property
    def retention(self) -> Retention:
        """The retention of maps that do not set their own."""
        return Retention(self.retained_revisions, self.retained_for_days, self.raw_scans)

    @field_validator("retained_revisions", mode="before")
    @classmethod
    def _count_or_all(cls, given: object) -> object:
        # Of a union pydantic reports what is wrong with each type that it tried.
        text = str(given).strip()
        is_count = text.isascii() and text.isdecimal() and len(text) <= len(str(MOST_REVISIONS))
        if given != "all" and not (is_count and int(text) <= MOST_REVISIONS):
            raise ValueError(f"should be a whole number from 0 to {MOST_REVISIONS}, or 'all'")
        return given

    @field_validator("allowed_origins", "trusted_proxies", mode="before")
    @classmethod
    def _split(cls, given: object) -> object:
        if isinstance(given, str):
            return tuple(part.strip() for part in given.split(",") if part.strip())
        return given


def unknown_variables(environment: Iterable[str]) -> list[str]:
    """Return the variables that look like a setting but are unknown, such as misspelt ones.

    Examples:
        >>> unknown_variables(["TENSORMAP_MAX_TRAKS", "TENSORMAP_MAX_TRACKS", "PATH"])
        ['TENSORMAP_MAX_TRAKS']
    """
    prefix = Settings.model_config["env_prefix"]
    known = {f"{prefix}{name.upper()}" for name in Settings.model_fields}
    return sorted(
        name
        for name in environment
        if name.upper().startswith(prefix) and name.upper() not in known
    )


def is_loopback(host: str) -> bool:
    """Return whether `host` is reachable from this machine only."""
    if host == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = getattr(address, "ipv4_mapped", None)
    return (mapped or address).is_loopback
