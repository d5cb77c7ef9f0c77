"""The encodings by name: the paper's, the harmonic one, and whatever registers itself."""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from core.errors import InvalidParameters, InvalidSignature
from core.projection.reducer import Reducer

if TYPE_CHECKING:
    from core.encodings.base import Encoding

DEFAULT_ENCODING = "harmonic"
"""Of what is built without naming one: docs/decisions/0010-harmonic-encoding.md."""


def _in(module: str) -> Callable[[], "Encoding"]:
    """Return what imports an encoding of ours when it is first used: commands begin sooner."""

    @cache
    def load() -> "Encoding":
        found: Encoding = import_module(module).ENCODING
        return found

    return load


_known: dict[str, Callable[[], "Encoding"]] = {
    "paper": _in("core.encodings.paper"),
    "harmonic": _in("core.encodings.harmonic"),
}


def register(encoding: "Encoding") -> None:
    """Make an encoding known by its name, in this process and those forked from it.

    Raises:
        InvalidParameters: If there is one of that name, or one of its layouts is another's.
    """
    if encoding.name in _known:
        raise InvalidParameters(f"there is an encoding {encoding.name!r} already")
    for name in encoding_names():
        if taken := encoding_named(name).layouts.keys() & encoding.layouts.keys():
            raise InvalidParameters(f"layout {min(taken)} of packed signatures is that of {name}")
    _known[encoding.name] = lambda: encoding


def unregister(name: str) -> None:
    """Forget an encoding that `register` made known."""
    del _known[name]


def encoding_names() -> tuple[str, ...]:
    """Return the names of all known encodings, ours first.

    Examples:
        >>> encoding_names()[:2]
        ('paper', 'harmonic')
    """
    return tuple(_known)


def encoding_named(name: str) -> "Encoding":
    """Return the encoding of this name.

    Raises:
        InvalidParameters: If there is none; lists the known ones.

    Examples:
        >>> encoding_named("paper").name
        'paper'
    """
    if name not in _known:
        raise InvalidParameters(f"encoding is {name!r:.80}, wanted {', '.join(_known)}")
    return _known[name]()


def encoding_of_layout(layout: int) -> "Encoding":
    """Return the encoding whose signatures are packed in this layout.

    Raises:
        InvalidSignature: If there is none; lists the known ones.
    """
    known: dict[int, str] = {}
    for name in _known:
        encoding = encoding_named(name)
        if layout in encoding.layouts:
            return encoding
        known |= encoding.layouts
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
        (name for name in _known if reducer in encoding_named(name).implied_by), DEFAULT_ENCODING
    )
