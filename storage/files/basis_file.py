"""A shared basis as one immutable HDF5 file (docs/reference/format.md)."""

import json
from pathlib import Path

from core.encodings.basis import Basis
from core.encodings.registry import encoding_named, encoding_names
from core.errors import TensorMapError
from core.parameters import MapParameters
from storage.durable_file import reading_back, write_whole
from storage.errors import CorruptFile
from storage.files.json_text import MOST_JSON_BYTES, parse_json
from storage.hdf5 import FileSource, Hdf5File
from storage.hdf5.writer import hdf5_in_memory

FORMAT = "tensormap-basis"
FORMAT_VERSION = 1

_MOST_WORD_BYTES = 256
_MOST_ARRAY_BYTES = 2**26  # of a basis on the largest grid


def write_basis(path: Path, basis: Basis) -> None:
    """Write a basis to a new file, wait until it is on disk, and read it back.

    Raises:
        FileExistsError: If there is a file.
        OSError: If it cannot be written, or is read back as something else.
    """
    content = hdf5_in_memory(
        {name: [array] for name, array in basis.arrays().items()},
        {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "parameters": json.dumps(basis.parameters.as_attributes(), sort_keys=True),
            "digest": basis.digest,
        },
    )
    write_whole(path, content)
    with reading_back():
        read_basis(path, basis.digest)


def read_basis(path: Path, digest: str) -> Basis:
    """Read a stored basis, whole or not at all; it names no revision.

    Args:
        path: The basis's file.
        digest: The basis's digest in the catalog.

    Raises:
        CorruptFile: If the file is no basis, is incomplete or its content has another digest.
        FileNotFoundError: If there is no such file.
    """
    try:
        with FileSource(path) as source:
            return _read(Hdf5File(source), digest)
    except CorruptFile as error:
        raise CorruptFile(f"{path.name} cannot be read as a basis: {error}") from error
    except (TensorMapError, TypeError, ValueError, KeyError) as error:
        raise CorruptFile(f"{path.name} holds no basis: {error}") from error


def _read(file: Hdf5File, digest: str) -> Basis:
    found = file.attributes
    if "format" not in found or found.text("format", _MOST_WORD_BYTES) != FORMAT:
        raise CorruptFile(f"it has no attribute format = {FORMAT}")
    if (version := found.whole("format_version")) != FORMAT_VERSION:
        raise CorruptFile(f"its format version is {version}, {FORMAT_VERSION} is read here")
    if (named := found.text("digest", _MOST_WORD_BYTES)) != digest:
        raise CorruptFile(f"it holds basis {named}, not {digest}")
    attributes = parse_json(found.text("parameters", MOST_JSON_BYTES), "its attribute parameters")
    if not isinstance(attributes, dict) or attributes.get("encoding") not in encoding_names():
        raise CorruptFile(f"its parameters are {attributes!r:.80}, of no known encoding")
    parameters = MapParameters.from_attributes(attributes)
    arrays = {}
    for name in sorted(file.names):
        dataset = file.dataset(name, contiguous=True)
        if dataset.size_bytes > _MOST_ARRAY_BYTES:
            raise CorruptFile(f"{name} takes {dataset.size_bytes} bytes")
        arrays[name] = dataset.read()
    # A basis checks that its content has this digest.
    return encoding_named(parameters.encoding).read_basis("", digest, parameters, arrays)
