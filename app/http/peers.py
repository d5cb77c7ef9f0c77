"""Addresses of peers and networks of IPv4, which a socket for `::` shows in the form of IPv6."""

from collections.abc import Iterable
from ipaddress import IPv4Network, IPv6Address, IPv6Network, ip_network

_MAPPED = "::ffff:"
_MAPPED_BITS = 96


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


def with_both_forms(networks: Iterable[str]) -> list[str]:
    """Return networks, and those of IPv4 in the form of IPv6, too, and the reverse.

    A peer is known by its plain address, but a proxy behind which another one listens on `::` is
    named in the other form.

    Examples:
        >>> plain, mapped = with_both_forms(["10.0.0.0/8"])  # Pythons write the second differently
        >>> plain, IPv6Network(mapped) == IPv6Network("::ffff:10.0.0.0/104")
        ('10.0.0.0/8', True)
        >>> with_both_forms(["::ffff:127.0.0.1"])[0]
        '127.0.0.1/32'
        >>> with_both_forms(["::/0", "fd00::/8"])  # neither trusts a peer of IPv4
        ['::/0', 'fd00::/8']
    """
    both = []
    for network in map(ip_network, networks):
        plain = _plain(network)
        if plain is not None:
            both.append(str(plain))
        if isinstance(network, IPv4Network):
            address, bits = network.network_address, _MAPPED_BITS + network.prefixlen
            both.append(str(IPv6Network(f"{_MAPPED}{address}/{bits}")))
        else:
            both.append(str(network))
    return both


def _plain(network: IPv4Network | IPv6Network) -> IPv4Network | None:
    if isinstance(network, IPv4Network):
        return network
    mapped = network.network_address.ipv4_mapped
    bits = network.prefixlen - _MAPPED_BITS
    return None if mapped is None else IPv4Network((int(mapped), bits))
