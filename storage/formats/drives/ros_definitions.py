"""Definitions of messages that a ROS bag has with it."""

import re
from typing import TYPE_CHECKING

from storage.formats.errors import MalformedDrive

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

# Texts, characters, comments and the arguments of annotations may have parentheses.
_OPENED = re.compile(
    r""""(?:[^"\\]|\\.)*(?:"|\\?\Z)|'(?:[^'\\]|\\.)'|//[^\n]*|/\*.*?(?:\*/|\Z)|@[\w:]+\s*\(|\(""",
    re.DOTALL,
)
_NO_FIELD = "structure_needs_at_least_one_member"  # takes no byte in ROS 1


def require_items_of_bytes(name: str, message: str, definitions: "Typesdict") -> None:
    """Check that each item of a message, as a bag defines it, needs bytes of the message.

    The library compares the lengths of sequences with those bytes. For fixed numbers of texts or
    messages it compiles lines of code for each item, and items without a field end nowhere: a few
    bytes would take hours and all memory.

    Args:
        name: The bag's.
        message: The message's type.
        definitions: Constants and fields of each type.

    Raises:
        MalformedDrive: If there are such fixed numbers, or messages without a field.
    """
    from rosbags.interfaces import Nodetype

    pending, seen = [message], set[str]()
    while pending:
        kind = pending.pop()
        if kind in seen or kind not in definitions:  # the library names what is not defined
            continue
        seen.add(kind)
        _, fields = definitions[kind]
        faults = [] if any(field != _NO_FIELD for field, _ in fields) else [f"{kind} has no field"]
        for field, description in fields:
            if description[0] in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
                item, number = description[1]
                of_numbers = item[0] == Nodetype.BASE and item[1][0] != "string"
                if description[0] == Nodetype.ARRAY and not of_numbers:
                    faults.append(f"{field!r} of {kind} is an array of {number} items")
            else:
                item = description
            if item[0] == Nodetype.NAME:
                pending.append(item[1])
        if faults:
            raise MalformedDrive(
                f"{name} defines {message} so that {faults[0]}, wanted it as ROS defines it"
            )


def require_plain_idl(message: str, idl: str) -> None:
    """Check that a definition in IDL has no parentheses in its constants, as ROS writes none.

    The library takes .2 s to parse a number in one pair, 17 s in two, and the square in four.

    Raises:
        MalformedDrive: If it has.
    """
    if any(found[0] == "(" for found in _OPENED.finditer(idl)):
        raise MalformedDrive(f"{message} is defined with a constant in (), wanted its value alone")
