"""The address of a connection's peer, as proxies and limits have it."""

from ipaddress import IPv6Address

_MAPPED = "::ffff:"


def plain_peer(peer: tuple[str, int] | None) -> tuple[str, int] | None:
    """Return a peer's address and port, an address of IPv4 as such.

    A socket for all addresses, `::`, shows it as one of IPv6: that of a proxy would be none of the
    trusted ones.

    Examples:
        >>> plain_peer(("::ffff:127.0.0.1", 443)), plain_peer(("::1", 443))
        (('127.0.0.1', 443), ('::1', 443))
    """
    if peer is None or not peer[0].startswith(_MAPPED):
        return peer
    mapped = IPv6Address(peer[0]).ipv4_mapped
    return (peer[0] if mapped is None else str(mapped), peer[1])
