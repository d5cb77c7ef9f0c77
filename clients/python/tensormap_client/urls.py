"""The URL of a service."""

import ipaddress
import re
from urllib.parse import urlsplit

import httpx2

from tensormap_client.errors import InvalidArgument

_USER = re.compile(r"(?<=//)[^/?#]*@")
_PRIVATE_NAMES = (".localhost", ".local", ".internal", ".home.arpa")
_VERSION = re.compile(r"/v1/*\Z")


def require_url(url: str) -> None:
    """Raise `InvalidArgument` if paths of a service cannot be put behind a URL."""
    try:
        parts = urlsplit(url)
        is_url = parts.scheme in {"http", "https"} and bool(parts.netloc)
        is_url &= not (parts.query or parts.fragment) and parts.port != 0  # beyond 65535 it raises
        httpx2.URL(url)
    except (AttributeError, TypeError, ValueError, httpx2.InvalidURL):  # the first two: no text
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


def is_private(url: str) -> bool:
    """Return whether a service is on this machine or in a network of its own, as a VPN.

    Of names these are those without a dot, as Docker gives services, and those that no public
    server has.

    Examples:
        >>> is_private("http://10.0.0.7:8000"), is_private("http://[fd00::7]")
        (True, True)
        >>> is_private("http://tensormap:8000"), is_private("http://truck-7.local")
        (True, True)
        >>> is_private("http://maps.example"), is_private("http://8.8.8.8")
        (False, False)
    """
    host = (urlsplit(url).hostname or "").removesuffix(".")
    try:
        return not ipaddress.ip_address(host).is_global
    except ValueError:
        return "." not in host or host.endswith(_PRIVATE_NAMES)


def shown(url: str) -> str:
    """Return a URL as messages show it: without the user and password for a proxy before it."""
    return _USER.sub("", url)
