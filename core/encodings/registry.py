"""The encodings by name: the paper's, the harmonic one, and those that are registered."""

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from core.errors import InvalidParameters, InvalidSignature
from core.projection.reducer import Reducer

if TYPE_CHECKING:
    from core.encodings.base import Encoding

DEFAULT_ENCODING = "harmonic"
"""The encoding of builds that name none: docs/decisions/0010-harmonic-encoding.md."""


_MODULES = {
    "paper": "core.encodings.paper.encoding",
    "harmonic": "core.encodings.harmonic.encoding",
}
"""Where the shipped encodings are; imported at the first use, so that commands start sooner."""

_registered: dict[str, "Encoding"] = {}


def register(encoding: "Encoding") -> None:
    """Register an encoding under its name, in this process and those forked from it.

    Raises:
        InvalidParameters: If the name, or one of its layouts, is already in use.
    """
    if encoding.name in encoding_names():
        raise InvalidParameters(f"there is an encoding {encoding.name!r} already")
    for name in encoding_names():
        if taken := encoding_named(name).layouts.keys() & encoding.layouts.keys():
            raise InvalidParameters(f"layout {min(taken)} of packed signatures is that of {name}")
    _registered[encoding.name] = encoding


def encoding_names() -> tuple[str, ...]:
    """Return the names of all encodings, the shipped ones first.

    Examples:
        >>> encoding_names()[:2]
        ('paper', 'harmonic')
    """
    return (*_MODULES, *_registered)


def encoding_named(name: str) -> "Encoding":
    """Return the encoding of this name.

    Raises:
        InvalidParameters: If there is none; lists the known ones.

    Examples:
        >>> encoding_named("paper").name
        'paper'
    """
    if name in _MODULES:
        return _shipped(name)
    if name not in _registered:
        raise InvalidParameters(f"encoding is {name!r:.80}, wanted {', '.join(encoding_names())}")
    return _registered[name]


def encoding_of_layout(layout: int) -> "Encoding":
    """Return the encoding whose signatures are packed in this layout.

    Raises:
        InvalidSignature: If there is none; lists the known ones.
    """
    encodings = [encoding_named(name) for name in encoding_names()]
    for encoding in encodings:
        if layout in encoding.layouts:
            return encoding
    known = {number: what for encoding in encodings for number, what in encoding.layouts.items()}
    listed = [f"{number} ({known[number]})" for number in sorted(known)]
    raise InvalidSignature(
        f"layout {layout} is unknown, wanted {', '.join(listed[:-1])} or {listed[-1]}"
    )


def encoding_with(reducer: Reducer | None) -> str:
    """Return the name of the default encoding, or of the one that alone uses such a reducer.

    Examples:
        >>> encoding_with(None), encoding_with(Reducer.LAST)
        ('harmonic', 'paper')
    """
    return next(
        (name for name in encoding_names() if reducer in encoding_named(name).implied_by),
        DEFAULT_ENCODING,
    )


@cache
def _shipped(name: str) -> "Encoding":
    shipped: Encoding = import_module(_MODULES[name]).ENCODING
    return shipped
