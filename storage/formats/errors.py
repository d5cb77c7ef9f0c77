"""The errors of scan files and recorded drives.

TensorMapError
├── InvalidScan
│   ├── EmptyBody           no bytes at all
│   ├── TruncatedScan       fewer bytes than the header says, or no whole number of records
│   ├── WrongDtype          numbers of another type than metres in floating point
│   ├── MalformedScan       a header or body that cannot be parsed
│   └── ScanTooLarge        more returns than a reader accepts
├── UnknownFormat           bytes that no reader claims
├── UnknownDriveLayout      a folder that is laid out like no drive
└── MalformedDrive          a file beside the scans that cannot be used
"""

from core.errors import InvalidScan, TensorMapError


def short(value: object) -> str:
    """Return an untrusted value for a message, at most 120 characters.

    Examples:
        >>> short("a" * 200)[:4], len(short("a" * 200))
        ("'aaa", 120)
    """
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python prints
        return "a number beyond printing"
    return text if len(text) <= 120 else f"{text[:117]}..."


class EmptyBody(InvalidScan):
    """An empty body where a scan, a signature or a file was wanted."""


class TruncatedScan(InvalidScan):
    """Fewer bytes than the header says, or not a whole number of records."""


class WrongDtype(InvalidScan):
    """Numbers that are not metres in floating point."""


class MalformedScan(InvalidScan):
    """A header or body that cannot be parsed."""


class ScanTooLarge(InvalidScan):
    """A scan of more returns, or that would unpack to more bytes, than a reader allows."""


class UnknownFormat(TensorMapError):
    """Bytes that no reader claims."""


class UnknownDriveLayout(TensorMapError):
    """A folder that is laid out like no drive."""


class MalformedDrive(TensorMapError):
    """Poses, times, a calibration or a GNSS track that cannot be used."""
