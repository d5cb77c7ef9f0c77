"""Paths of the service's resources.

Each name is one segment. One that would lead elsewhere raises `InvalidArgument`: a drive called
`..` would be its map, also when it is deleted.
"""

from urllib.parse import quote

from tensormap_client.errors import InvalidArgument


def map_path(map_slug: str) -> str:
    """Return the path of a map."""
    return f"/v1/maps/{_segment(map_slug)}"


def drive_path(map_slug: str, drive_slug: str) -> str:
    """Return the path of a drive."""
    return f"{map_path(map_slug)}/drives/{_segment(drive_slug)}"


def capture_path(map_slug: str, drive_slug: str, capture: str) -> str:
    """Return the path of an uploaded capture."""
    return f"{drive_path(map_slug, drive_slug)}/captures/{_segment(capture)}"


def revision_path(map_slug: str, revision: str) -> str:
    """Return the path of a revision."""
    return f"{map_path(map_slug)}/revisions/{_segment(revision)}"


def basis_path(name: str) -> str:
    """Return the path of a shared basis."""
    return f"/v1/bases/{_segment(name)}"


def job_path(job: str) -> str:
    """Return the path of a job."""
    return f"/v1/jobs/{_segment(job)}"


def key_path(key: str) -> str:
    """Return the path of a key."""
    return f"/v1/keys/{_segment(key)}"


def recycled_path(entry: str) -> str:
    """Return the path of an entry of the recycle bin."""
    return f"/v1/recycle-bin/{_segment(entry)}"


def _segment(name: str) -> str:
    # A quoted slash does not help: servers and proxies read it as a slash.
    if name in {"", ".", ".."} or "/" in name:
        raise InvalidArgument(f"{name!r} leads to nothing of that kind: wanted a name without '/'")
    return quote(name, safe="")
