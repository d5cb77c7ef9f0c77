"""The proxies that the environment names (`http_proxy`, `https_proxy`, `all_proxy`)."""

import contextlib
from ipaddress import ip_address, ip_network
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

_PORTS = {"http": 80, "https": 443}


def proxy_of(url: str) -> str | None:
    """Return the proxy to a service, for requests and streams alike; `None` if there is none.

    The HTTP and the WebSocket library differ in which one they choose: only one knows `all_proxy`,
    networks in `no_proxy` and proxies without a scheme, and the other takes `https_proxy` for http.
    """
    parts, known = urlsplit(url), getproxies()
    found = known.get(parts.scheme) or known.get("all")
    if not found or is_on_this_machine(url):
        return None
    host, port = parts.hostname or "", parts.port or _PORTS[parts.scheme]
    if proxy_bypass(host) or proxy_bypass(f"{host}:{port}") or _is_in(host, known.get("no", "")):
        return None
    return found if "://" in found else f"http://{found}"


def _is_in(host: str, no_proxy: str) -> bool:
    """Return whether a host is an address in one of the networks of `no_proxy`."""
    for word in no_proxy.split(","):
        with contextlib.suppress(ValueError):  # one of them is a name
            if ip_address(host) in ip_network(word.strip(), strict=False):
                return True
    return False


def is_on_this_machine(url: str) -> bool:
    """Return whether a URL is of this machine, which no proxy can reach."""
    host = urlsplit(url).hostname or ""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
