"""Checks of arguments, before anything is sent."""

import math
import re
from numbers import Real

from tensormap_client.errors import InvalidArgument

_SLUG = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")


_MOST_SHOWN = 80  # characters of a value


def require_number(name: str, value: object, most: float = math.inf) -> None:
    """Raise `InvalidArgument` if a value is no finite number from `-most` to `most`."""
    number = _float(value)
    if not (math.isfinite(number) and -most <= number <= most):
        bounds = " that is finite" if math.isinf(most) else f" from -{most:g} to {most:g}"
        raise InvalidArgument(f"{name} is {_shown(value)}, wanted a number{bounds}")


def require_timeout(value: object, most: float) -> None:
    """Raise `InvalidArgument` if a value is no time to wait for an answer, in seconds."""
    if not 0.0 < _float(value) <= most:
        raise InvalidArgument(f"timeout_s is {_shown(value)}, wanted above 0 and at most {most:g}")


def require_patience(value: object) -> None:
    """Raise `InvalidArgument` if a value is no time to retry for, in seconds."""
    if not _float(value) >= 0.0:
        raise InvalidArgument(f"patience_s is {_shown(value)}, wanted a float of 0 or more")


def require_height(name: str, value: object) -> None:
    """Raise `InvalidArgument` if a value is no height of a sensor above ground."""
    if not 0.0 < _float(value) < 100.0:
        raise InvalidArgument(f"{name} is {_shown(value)}, wanted above 0 and below 100")


def _float(value: object) -> float:
    """Return a number as a float, NaN if it is none or an integer too large for one."""
    try:
        return float(value) if isinstance(value, Real) else math.nan
    except OverflowError:
        return math.nan


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4,300 digits
        return "an integer of too many digits"
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."


def require_slug(name: str, value: object) -> None:
    """Raise `InvalidArgument` if a value is no slug, as every map and drive has one."""
    if not (isinstance(value, str) and _SLUG.fullmatch(value)):
        raise InvalidArgument(
            f"{name} {value!r} is no slug: wanted 1 to 64 of a-z, 0-9, '.', '_' and '-', beginning"
            " with a letter or digit"
        )


def require_several(name: str, values: object) -> None:
    """Raise `InvalidArgument` for a single string, of which each letter would be one of several."""
    if isinstance(values, str):
        raise InvalidArgument(f"{name} is {values!r}, wanted several, as [{values!r}]")


def require_key(key: object) -> None:
    """Raise `InvalidArgument` if a value is no key that a request can have."""
    if not (key is None or isinstance(key, str)):
        raise InvalidArgument(f"the key is a {type(key).__name__}, wanted a str or None")
    if key == "":
        raise InvalidArgument("the key is empty: None is for a service that needs none")
    if key is not None and not (key.isascii() and key.isprintable() and key == key.strip()):
        raise InvalidArgument(
            "the key has characters that no key has: wanted printable ASCII in one line,"
            " without spaces around it"
        )
