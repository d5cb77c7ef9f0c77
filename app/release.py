"""The release of the service."""

from functools import cache
from importlib.metadata import version

DISTRIBUTION = "tensormap-server"


@cache
def release() -> str:
    """Return the version of what is installed; a millisecond to read, so it is read once."""
    return version(DISTRIBUTION)
