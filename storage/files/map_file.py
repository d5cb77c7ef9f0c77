"""A map revision as one immutable, packed HDF5 file (docs/reference/format.md)."""

import json
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.encodings.registry import encoding_named, encoding_names
from core.errors import InvalidParameters, TensorMapError
from core.mapping.placement import Placement, placements_from_attributes
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Views
from storage.durable_file import reading_back, write_whole
from storage.errors import CorruptFile
from storage.files.json_text import MOST_JSON_BYTES, parse_json
from storage.hdf5 import BytesSource, ContiguousDataset, Dataset, FileSource, Hdf5File, Source
from storage.hdf5.writer import hdf5_in_memory

FORMAT = "tensormap"
FORMAT_VERSION = 3
"""Version of maps whose signatures are codes; others have version 1, or 2 of any views."""

_CODED = 3  # since when signatures of encodings that have codes are codes
_MOST_WORD_BYTES = 256  # of an attribute that is a word or a digest
_REMEMBERED = 4096  # files whose digest was checked

_OF_ALL = {
    "segment_start": "<i8",
    "relative_error": "<f8",
    "drive_start": "<i8",
    "scan_index": "<i8",
    "timestamp_s": "<f8",
    "pose": "<f8",
    "node_scan": "<i8",
    "edge_nodes": "<i8",
    "edge_length_m": "<f8",
}
_OF_JOINED = {"edge_scans": "<i8", "edge_of_segment": "<i8", "segment_reversed": "|i1"}
"""All three or none: a map whose segments are its edges has none of them."""


def write_map(path: str | Path, tensor_map: TensorMap, created_at: datetime | None = None) -> None:
    """Write a revision to a new file, wait until it is on disk, and read it back.

    The caller publishes it: `storage.files.files`.

    Args:
        path: A file that does not exist yet.
        tensor_map: The content.
        created_at: Stored outside of the digest.

    Raises:
        FileExistsError: If there is a file.
        OSError: If it cannot be written, or is read back as something else.
        InvalidParameters: If the content is no map, as with the arguments in the other order.
    """
    if not isinstance(tensor_map, TensorMap):
        raise InvalidParameters(
            f"wanted write_map(path, tensor_map), got {type(tensor_map).__name__} as the map"
        )
    attributes = tensor_map.attributes()
    parameters = tensor_map.parameters
    arrays = tensor_map.arrays()
    coded = "signature_codes" in arrays
    version = FORMAT_VERSION if coded else 1 if parameters.views == Views.FULL else 2
    own = parameters.encoder.arrays_of(attributes, coded=coded)
    dtypes = {**own, **_OF_ALL, **_OF_JOINED}
    content = hdf5_in_memory(
        {name: [np.asarray(array, dtypes[name])] for name, array in arrays.items()},
        {
            "format": FORMAT,
            "format_version": version,
            "attributes": json.dumps(attributes, sort_keys=True),
            "digest": tensor_map.revision,
            "created_at": (created_at or datetime.now(UTC)).isoformat(),
        },
    )
    path = Path(path)
    write_whole(path, content)
    with reading_back():
        read_revision(path, tensor_map.revision)


def read_map(path: str | Path) -> TensorMap:
    """Read a revision, whole or not at all.

    Raises:
        CorruptFile: If the file is no map, is incomplete or its content has another digest.
        FileNotFoundError: If there is no such file.
    """
    path = Path(path)
    with _named(path.name or str(path)), FileSource(path) as source:
        tensor_map = _whole(source)
        _checked.add(source.identity)
        return tensor_map


def map_of_bytes(content: bytes, name: str) -> TensorMap:
    """Read a revision from bytes in memory, whole or not at all.

    Args:
        content: A file's bytes.
        name: The name of the bytes, for errors.

    Raises:
        CorruptFile: If they are no map, are incomplete or the content has another digest.
    """
    with _named(name):
        return _whole(BytesSource(content))


def read_revision(path: Path, digest: str) -> TensorMap:
    """Read a stored revision; the digest of its content is checked once in a process.

    All addresses and checksums of the file's structure are checked every time. A file that was
    changed or replaced since is checked like a new one.

    Args:
        path: The revision's file.
        digest: The revision's digest in the catalog.

    Raises:
        CorruptFile: If the file is no map, is incomplete or holds another revision.
        FileNotFoundError: If there is no such file.
    """
    with _named(path.name), FileSource(path) as source:
        if source.identity in _checked:
            tensor_map = TensorMap.from_parts(*_parts(source))
        else:
            tensor_map = _whole(source)
            _checked.add(source.identity)
        if tensor_map.revision != digest:
            raise CorruptFile(f"it holds {tensor_map.revision}, not revision {digest}")
    return tensor_map


def read_parameters(
    path: Path, digest: str
) -> tuple[MapParameters, Mapping[str, Placement | None]]:
    """Return the parameters and the drives of a stored revision; no array is read.

    Drives are in their order, each with the transform of its poses, `None` without one.

    Raises:
        CorruptFile: If the file is no map, or has the digest of another revision.
        FileNotFoundError: If there is no such file.
    """
    with _named(path.name), FileSource(path) as source:
        attributes, found, _ = _head(Hdf5File(source))
        if found != digest:
            raise CorruptFile(f"its digest is {found}, not that of revision {digest}")
        parameters = MapParameters.from_attributes(attributes)
        drives = attributes.get("drives")
        if not isinstance(drives, list) or not all(isinstance(name, str) for name in drives):
            raise CorruptFile(f"its drives are {drives!r:.80}, wanted a list of names")
        placements = placements_from_attributes(attributes)
        return parameters, {name: placements.get(name) for name in drives}


class _CheckedFiles:
    """The files whose digest this process has checked, the most recent ones."""

    def __init__(self) -> None:
        self._identities: OrderedDict[tuple[int, ...], None] = OrderedDict()
        self._lock = threading.Lock()

    def __contains__(self, identity: tuple[int, ...]) -> bool:
        return identity in self._identities

    def add(self, identity: tuple[int, ...]) -> None:
        with self._lock:
            self._identities[identity] = None
            while len(self._identities) > _REMEMBERED:
                self._identities.popitem(last=False)


_checked = _CheckedFiles()


@contextmanager
def _named(name: str) -> Iterator[None]:
    try:
        yield
    except CorruptFile as error:
        raise CorruptFile(f"{name} cannot be read as a map: {error}") from error
    except TensorMapError as error:
        raise CorruptFile(f"{name} holds no map: {error}") from error


def _whole(source: Source) -> TensorMap:
    arrays, attributes, digest = _parts(source)
    tensor_map = TensorMap.from_parts(arrays, attributes)
    if tensor_map.revision != digest:
        raise CorruptFile(f"its digest is {digest}, its content is {tensor_map.revision}")
    # Once in a process, as the digest: a thousand bases of the paper take 5 ms.
    tensor_map.model.require_orthonormal()
    return tensor_map


def _parts(source: Source) -> tuple[dict[str, NDArray[Any]], dict[str, Any], str]:
    file = Hdf5File(source)
    attributes, digest, version = _head(file)
    dtypes = _dtypes(attributes, version)
    if not file.names.isdisjoint(_OF_JOINED):
        dtypes = {**dtypes, **_OF_JOINED}
    if odd := file.names ^ dtypes.keys():
        raise CorruptFile(f"it lacks or should not hold {', '.join(sorted(odd))}")
    datasets = {
        name: _plain(file.dataset(name, contiguous=True), dtypes[name]) for name in sorted(dtypes)
    }
    size_bytes = sum(dataset.size_bytes for dataset in datasets.values())
    if size_bytes > source.size_bytes:
        raise CorruptFile(f"its arrays take {size_bytes} bytes, the file {source.size_bytes}")
    arrays = {
        # Codes and images: all that is large. Other numbers may not lie where a processor wants.
        name: dataset.mapped() if dataset.dtype.itemsize == 1 else dataset.read()
        for name, dataset in datasets.items()
    }
    return arrays, attributes, digest


def _head(file: Hdf5File) -> tuple[dict[str, Any], str, int]:
    """Return the map's attributes, and the digest and the format's version in the file."""
    found = file.attributes
    if "format" not in found or found.text("format", _MOST_WORD_BYTES) != FORMAT:
        raise CorruptFile("it has no attribute format = tensormap")
    version = found.whole("format_version")
    if not 1 <= version <= FORMAT_VERSION:
        raise CorruptFile(f"its format version is {version}, 1 to {FORMAT_VERSION} are read here")
    attributes = parse_json(found.text("attributes", MOST_JSON_BYTES), "its attribute attributes")
    return attributes, found.text("digest", _MOST_WORD_BYTES), version


def _dtypes(attributes: object, version: int) -> dict[str, str]:
    if not isinstance(attributes, dict):
        raise CorruptFile(f"its attributes are {attributes!r:.80}, wanted names and values")
    name = attributes.get("encoding")
    if not isinstance(name, str) or name not in encoding_names():
        raise CorruptFile(f"its encoding is {name!r:.80}, wanted {', '.join(encoding_names())}")
    own = encoding_named(name).arrays_of(attributes, coded=version >= _CODED)
    return {**own, **_OF_ALL}


def _plain(dataset: Dataset, dtype: str) -> ContiguousDataset:
    """Reject an array of another kind of numbers, or one that is not contiguous."""
    name = dataset.name
    if dataset.dtype != np.dtype(dtype):
        raise CorruptFile(f"{name} holds {dataset.dtype}, wanted {dtype}")
    if not isinstance(dataset, ContiguousDataset):
        raise CorruptFile(f"{name} is filtered or chunked; a map's arrays are contiguous")
    return dataset
