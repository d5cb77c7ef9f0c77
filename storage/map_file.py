"""A map revision as one immutable, packed HDF5 file (docs/reference/format.md)."""

import errno
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from core.errors import TensorMapError
from core.parameters import Encoding
from core.tensormap import TensorMap
from storage.errors import CorruptFile

__all__ = ["FORMAT", "FORMAT_VERSION", "read_map", "write_map"]

FORMAT = "tensormap"
FORMAT_VERSION = 1

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
_DTYPES = {
    Encoding.PAPER: {
        "elevation_basis": "<f4",
        "azimuth_basis": "<f4",
        "signatures": "<f4",
        **_OF_ALL,
    },
    Encoding.HARMONIC: {
        "radial_basis": "<f4",
        "signatures": "<c8",
        "lateral_offset_m": "<f8",
        **_OF_ALL,
    },
}

_OF_JOINED = {"edge_scans": "<i8", "edge_of_segment": "<i8", "segment_reversed": "|i1"}
"""All three or none: a map whose segments are its edges has none of them."""


def write_map(path: Path, tensor_map: TensorMap, created_at: datetime | None = None) -> None:
    """Write a revision to a new file and give its bytes to the disk's care.

    The caller publishes it: writes beside, syncs and renames (`storage.files`).

    Args:
        path: A file that does not exist yet.
        tensor_map: The content.
        created_at: Kept beside the digest, outside of it.
    """
    dtypes = {**_DTYPES[tensor_map.parameters.encoding], **_OF_JOINED}
    with h5py.File(path, "x", libver="v110") as file:
        for name, array in tensor_map.arrays().items():
            file.create_dataset(name, data=np.asarray(array, dtypes[name]))
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        file.attrs["attributes"] = json.dumps(tensor_map.attributes(), sort_keys=True)
        file.attrs["digest"] = tensor_map.revision
        file.attrs["created_at"] = (created_at or datetime.now(UTC)).isoformat()


def read_map(path: Path) -> TensorMap:
    """Read a revision, whole or not at all.

    Raises:
        CorruptFile: If the file is no map, lacks something or its content has another digest.
        FileNotFoundError: If there is no such file.
    """
    if not path.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    try:
        arrays, attributes, digest = _read_parts(path)
    # RuntimeError is HDF5's own, and that of attributes nested too deep.
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError) as error:
        raise CorruptFile(f"{path.name} cannot be read as a map: {error}") from error
    try:
        tensor_map = TensorMap.from_parts(arrays, attributes)
    except TensorMapError as error:
        raise CorruptFile(f"{path.name} holds no map: {error}") from error
    if tensor_map.revision != digest:
        raise CorruptFile(
            f"{path.name} says it holds {digest}, its content is {tensor_map.revision}"
        )
    return tensor_map


def _read_parts(path: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
    with h5py.File(path, "r", locking=False) as file:  # immutable: also on a read-only disk
        if file.attrs.get("format") != FORMAT:
            raise ValueError("it has no attribute format = tensormap")
        version = int(file.attrs["format_version"])
        if version != FORMAT_VERSION:
            raise ValueError(f"its format version is {version}, {FORMAT_VERSION} is read here")
        attributes = json.loads(file.attrs["attributes"])
        dtypes = _DTYPES[Encoding(attributes["encoding"])]
        if any(name in file for name in _OF_JOINED):
            dtypes = {**dtypes, **_OF_JOINED}
        odd = set(file) ^ set(dtypes)
        if odd:
            raise ValueError(f"it lacks or should not hold {', '.join(sorted(odd))}")
        size_bytes = path.stat().st_size
        return (
            {name: _plain(file, name, dtypes[name], size_bytes) for name in file},
            attributes,
            str(file.attrs["digest"]),
        )


def _plain(file: h5py.File, name: str, dtype: str, size_bytes: int) -> np.ndarray[Any, Any]:
    """Read an array that lies in this file: no link elsewhere, no filter, no stored code."""
    link = file.get(name, getlink=True)
    dataset = file[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(dataset, h5py.Dataset) or dataset.shape is None:
        raise ValueError(f"{name} is no plain array of numbers")
    if dataset.dtype != np.dtype(dtype):
        raise ValueError(f"{name} holds {dataset.dtype}, wanted {dtype}")
    if dataset.external or dataset.is_virtual:
        raise ValueError(f"{name} keeps its numbers in another file")
    if dataset.id.get_create_plist().get_nfilters():
        raise ValueError(f"{name} is filtered; a map's arrays are contiguous")
    if dataset.chunks is not None:
        raise ValueError(f"{name} is chunked; a map's arrays are contiguous")
    if dataset.nbytes > min(dataset.id.get_storage_size(), size_bytes):
        raise ValueError(f"{name} has more numbers than the file")
    array: np.ndarray[Any, Any] = dataset[()]
    return array
