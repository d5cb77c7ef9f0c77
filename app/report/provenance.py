"""The version, machine and date of a report."""

import platform
from datetime import UTC, datetime

from app import provenance as made


def provenance() -> dict[str, str]:
    """Return what figures depend on besides the drive and the configuration."""
    of = made.provenance()
    return {
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": of["tensormap"],
        "commit": of["commit"] or "unknown: not run from a checkout",
        "machine": f"{of['machine']}, {platform.system()} {platform.machine()}",
        "python": f"Python {of['python']}, NumPy {of['numpy']}",
    }
