"""Text that can be shown: names, descriptions and counts that reach a disk or an answer."""

import re

LONGEST_NAME = 255
"""Longest name of a drive, in characters; a folder's name may be as long."""

_LEFT_OUT = " ... "

# Controls (C0, delete, C1), breaks of lines and paragraphs, marks that turn the direction of the
# text around them, and lone halves of surrogate pairs.
_UNSHOWN = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def flaw_in(text: object, most: int, *, allowed: str = "") -> str | None:
    r"""Return why `text` cannot be shown, `None` if it can.

    Args:
        text: Anything.
        most: How many characters it may have; it must have one.
        allowed: Control characters that it may have.

    Examples:
        >>> flaw_in("Straße 7", 64) is None, flaw_in("a\nb", 64, allowed="\n") is None
        (True, True)
        >>> flaw_in("a\ud800", 64)
        "it has the character '\\ud800'"
    """
    if not isinstance(text, str):
        return f"it is a {type(text).__name__}, wanted text"
    if not 1 <= len(text) <= most:
        return f"it has {len(text)} characters, wanted 1 to {most}"
    for found in _UNSHOWN.finditer(text):
        if found[0] not in allowed:
            return f"it has the character {found[0]!a}"
    return None


def escaped(text: str) -> str:
    r"""Return a text with each character that cannot be shown as its escape.

    Examples:
        >>> print(escaped("a\nb"), escaped("Straße \u202e7"))
        a\nb Straße \u202e7
    """
    return _UNSHOWN.sub(lambda found: ascii(found[0])[1:-1], text)


def shortened(text: str, most: int) -> str:
    """Return the begin and the end of a text that is longer than `most` characters.

    Examples:
        >>> shortened("0123456789", 10), shortened("0123456789", 9)
        ('0123456789', '01 ... 89')
    """
    if len(text) <= most:
        return text
    kept = most - len(_LEFT_OUT)
    return f"{text[: kept - kept // 2]}{_LEFT_OUT}{text[len(text) - kept // 2 :]}"


def count_of(count: int, one: str, many: str | None = None) -> str:
    """Return a count with its noun.

    Args:
        count: How many.
        one: The noun's singular.
        many: Its plural, by default with an s.

    Examples:
        >>> count_of(1, "scan"), count_of(2, "scan"), count_of(0, "query", "queries")
        ('1 scan', '2 scans', '0 queries')
    """
    return f"{count} {one if count == 1 else many or f'{one}s'}"


def verb_of(count: int, one: str, many: str) -> str:
    """Return the form of a verb that agrees with a count.

    Examples:
        >>> [f"{count} of 9 scans {verb_of(count, 'has', 'have')} no pose" for count in (1, 2)]
        ['1 of 9 scans has no pose', '2 of 9 scans have no pose']
    """
    return one if count == 1 else many


def shown(value: object) -> object:
    r"""Return plain values with every text in them replaced by one that UTF-8 can encode.

    Examples:
        >>> shown({"drives": ["a\ud800"]})
        {'drives': ['a?']}
    """
    match value:
        case str():
            return value.encode("utf-8", "replace").decode("utf-8")
        case dict():
            return {shown(key): shown(item) for key, item in value.items()}
        case list() | tuple():
            return [shown(item) for item in value]
        case _:
            return value
