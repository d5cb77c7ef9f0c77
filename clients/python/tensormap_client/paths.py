"""Paths of the service's resources."""

from urllib.parse import quote


def map_path(map_slug: str) -> str:
    """Return the path of a map."""
    return f"/v1/maps/{quote(map_slug, safe='')}"


def drive_path(map_slug: str, drive_slug: str) -> str:
    """Return the path of a drive."""
    return f"{map_path(map_slug)}/drives/{quote(drive_slug, safe='')}"


def basis_path(name: str) -> str:
    """Return the path of a shared basis."""
    return f"/v1/bases/{quote(name, safe='')}"
