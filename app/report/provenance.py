"""With what, on what and when a report was made."""

import platform
import shutil
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

__all__ = ["commit", "processor", "provenance"]

_ROOT = Path(__file__).parents[2]


def provenance() -> dict[str, str]:
    """Return what figures depend on besides the drive and the configuration."""
    return {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": version("tensormap-server"),
        "commit": commit() or "unknown: not run from a checkout",
        "machine": f"{processor()}, {platform.system()} {platform.machine()}",
        "python": f"Python {platform.python_version()}, NumPy {np.__version__}",
    }


def commit() -> str | None:
    """Name the commit of the checkout that this module lies in, `None` outside of one."""
    git = shutil.which("git")
    if git is None or not (_ROOT / ".git").exists():
        return None
    said = subprocess.run(  # noqa: S603  # fixed words, no input of anybody's
        [git, "-C", str(_ROOT), "describe", "--always", "--dirty", "--abbrev=12"],
        capture_output=True,
        text=True,
        check=False,
    )
    return said.stdout.strip() or None


def processor(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """Name the processor."""
    try:
        lines = cpuinfo.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == "model name" and value.strip():
            return value.strip()
    return platform.processor() or platform.machine() or "unknown processor"
