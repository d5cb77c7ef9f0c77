"""Provenance of a published figure: release, commit, machine."""

import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from app.release import release

_SOURCE = Path(__file__).parents[1]


def provenance() -> dict[str, Any]:
    """Return release, commit, machine and versions as plain values."""
    return {
        "tensormap": release(),
        "commit": commit(),
        "machine": machine(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": version("scipy"),
        "threads": 1,
    }


def of_report() -> dict[str, str]:
    """Return what the figures of a report depend on besides the drive and the configuration."""
    of = provenance()
    return {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": of["tensormap"],
        "commit": of["commit"] or "unknown: not run from a checkout",
        "machine": f"{of['machine']}, {platform.system()} {platform.machine()}",
        "python": f"Python {of['python']}, NumPy {of['numpy']}",
    }


def commit() -> str | None:
    """Return the commit that runs, `-dirty` if files were changed; `None` outside a checkout."""
    if not (_SOURCE / ".git").exists():
        return None
    command = ["git", "-C", str(_SOURCE), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 - no foreign input
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def machine(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """Return the system's name of the processor."""
    try:
        lines = cpuinfo.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.processor() or platform.machine() or "unknown")
