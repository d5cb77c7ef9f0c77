"""The URL of a service."""

import re
from urllib.parse import urlsplit

import httpx2

from tensormap_client.errors import InvalidArgument

_USER = re.compile(r"(?<=//)[^/?#]*@")
_VERSION = re.compile(r"/v1/*\Z")


def require_url(url: str) -> None:
    """Raise `InvalidArgument` if paths of a service cannot be put behind a URL."""
    try:
        parts = urlsplit(url)
        is_url = parts.scheme in {"http", "https"} and bool(parts.netloc)
        is_url &= not (parts.query or parts.fragment)
        httpx2.URL(url)
    except (ValueError, httpx2.InvalidURL):
        is_url = False
    if not is_url:
        raise InvalidArgument(
            f"{shown(str(url))!r} is no URL of a service, as http://127.0.0.1:8000"
        )


def service_url(url: str) -> str:
    """Return what the paths of a service follow: its URL without `/v1`, which they begin with.

    Examples:
        >>> service_url("http://127.0.0.1:8000/v1/"), service_url("HTTPS://maps.example/under")
        ('http://127.0.0.1:8000', 'https://maps.example/under')
    """
    return _VERSION.sub("", urlsplit(url).geturl()).rstrip("/")


def shown(url: str) -> str:
    """Return a URL as messages show it: without the user and password for a proxy before it."""
    return _USER.sub("", url)
