"""Files in HDF5's first structures, which have no checksums: older chunk files, copied maps."""

import json
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np


def copied_map(path: Path, tensor_map) -> Path:
    """Write a map as an older copy looks, made dataset by dataset with h5py."""
    with h5py.File(path, "x") as file:
        for name, array in tensor_map.arrays().items():
            file.create_dataset(name, data=array)
        file.attrs["format"] = "tensormap"
        file.attrs["format_version"] = 1
        file.attrs["attributes"] = json.dumps(tensor_map.attributes(), sort_keys=True)
        file.attrs["digest"] = tensor_map.revision
        file.attrs["created_at"] = datetime(2026, 1, 1, tzinfo=UTC).isoformat()
    return path


def older_chunk(path: Path, scans) -> Path:
    """Write a chunk file as version 0.1 did."""
    starts = np.cumsum([0, *(len(scan) for _, scan in scans)], dtype="<i8")
    with h5py.File(path, "x") as file:
        file.attrs["format"] = "tensormap-drive-chunk"
        file.attrs["format_version"] = 1
        file["scan_start"] = starts
        file["scan_index"] = np.array([index for index, _ in scans], dtype="<i8")
        points = file.create_dataset("points_m", shape=(starts[-1], 3), dtype="<f4")
        for row, (_, scan) in enumerate(scans):
            points[starts[row] : starts[row + 1]] = scan.points_m
    return path
