"""Files as releases before 0.2 wrote them: by the HDF5 library, through h5py."""

import json
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np

from core.grams import drive_gram
from core.images import project_drive
from storage.image_file import PROBE_VERSION

__all__ = ["older_chunk", "older_images", "older_map"]


def older_map(path: Path, tensor_map, libver="v110") -> Path:
    """Write a map; with `libver=None` as a copy looks that somebody made with h5py."""
    with h5py.File(path, "x", libver=libver) as file:
        for name, array in tensor_map.arrays().items():
            file.create_dataset(name, data=array)
        file.attrs["format"] = "tensormap"
        file.attrs["format_version"] = 1
        file.attrs["attributes"] = json.dumps(tensor_map.attributes(), sort_keys=True)
        file.attrs["digest"] = tensor_map.revision
        file.attrs["created_at"] = datetime(2026, 1, 1, tzinfo=UTC).isoformat()
    return path


def older_chunk(path: Path, scans) -> Path:
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


def older_images(path: Path, drive, imager) -> Path:
    """Write the images of a drive, room being made for all its scans before any is projected."""
    made = project_drive(drive, np.arange(len(drive)), imager)
    cells, probed = made.images.read(0, len(made.images)), made.probes.read(0, len(made.probes))
    renderings = imager.shape[0] if imager.lateral_renderings_m is not None else 1
    block = min(max(1, 8 // renderings), len(drive))
    with h5py.File(path, "x", libver="v110") as file:
        for name, array, rows, length in (
            ("images", cells, len(drive), block),
            ("probes", probed, max(1, len(probed)), 1),
        ):
            shape = (rows, *array.shape[1:])
            dataset = file.create_dataset(
                name,
                shape=shape,
                maxshape=shape,
                chunks=(length, *array.shape[1:]),
                dtype="<f4",
                fletcher32=True,
            )
            for row, image in enumerate(array):
                dataset[row] = image
            dataset.resize(len(array), axis=0)
        checked = bool(made.probed.size)
        file.create_dataset("probed", data=made.probed.astype("<i8"), fletcher32=checked)
        file.create_dataset("standing", data=made.standing.astype("<f8"), fletcher32=checked)
        file.attrs["probe_version"] = PROBE_VERSION
        file.create_dataset("scans", data=made.scans.astype("<i8"), fletcher32=True)
        if imager.lateral_renderings_m is not None:
            gram = drive_gram(made.images, 0, len(made.images))
            file.create_dataset("detail_gram", data=gram.astype("<f8"), fletcher32=True)
        file.attrs["returns"] = made.returns
        skipped = [[item.scan, item.reason] for item in made.skipped]
        file.attrs["skipped"] = json.dumps(skipped)
    return path
