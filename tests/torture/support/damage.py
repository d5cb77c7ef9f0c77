"""Damage as disks, wires and attackers do it to a file."""

import random
from collections.abc import Callable

_SECTOR = 512
_WORD = 8


def flipped(content: bytes, chance: random.Random) -> bytes:
    """Return it with one bit changed."""
    changed = bytearray(content)
    changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _byte(content: bytes, chance: random.Random) -> bytes:
    changed = bytearray(content)
    changed[chance.randrange(len(changed))] = chance.choice((0, 1, 0x7F, 0x80, 0xFF))
    return bytes(changed)


def _word(content: bytes, chance: random.Random) -> bytes:
    """Put another word of the file in the place of one: addresses then lead in circles."""
    changed = bytearray(content)
    words = len(changed) // _WORD
    to, source = (chance.randrange(words) * _WORD for _ in range(2))
    changed[to : to + _WORD] = content[source : source + _WORD]
    return bytes(changed)


def _huge(content: bytes, chance: random.Random) -> bytes:
    changed = bytearray(content)
    at = chance.randrange(len(changed) - _WORD)
    size = chance.choice((2, 4, 8))
    value = chance.choice((2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1))
    changed[at : at + size] = (value % 2 ** (8 * size)).to_bytes(size, "little")
    return bytes(changed)


def _sector(content: bytes, chance: random.Random) -> bytes:
    changed = bytearray(content)
    at = chance.randrange(-(-len(changed) // _SECTOR)) * _SECTOR
    length = len(changed[at : at + _SECTOR])
    changed[at : at + _SECTOR] = chance.choice((bytes(length), chance.randbytes(length)))
    return bytes(changed)


def _cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def _longer(content: bytes, chance: random.Random) -> bytes:
    return content + chance.randbytes(chance.randint(1, 2 * _SECTOR))


DAMAGES: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    flipped, _byte, _word, _huge, _sector, _cut, _longer,
)  # fmt: skip
_WEIGHTS = (12, 2, 3, 2, 1, 1, 1)  # mostly single bits


def damaged(content: bytes, chance: random.Random) -> bytes:
    """Return it with some damage, mostly of one bit."""
    [way] = chance.choices(DAMAGES, _WEIGHTS)
    return way(content, chance)
