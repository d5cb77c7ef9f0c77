"""Small bodies as vehicles and administrators send them, and what is known of each."""

import functools
import hashlib
import io
import tempfile
from pathlib import Path

import numpy as np

from core.scans.scan import Scan
from storage.files.drive_chunks import scan_digest
from storage.files.map_file import read_map, write_map
from tests.support.recording import kitti, npy, recording, tar
from tests.support.samples import sample_harmonic_map, sample_map

HDF5 = {"Content-Type": "application/vnd.tensormap.map+hdf5"}
_RETURNS = 100  # the fewest that are taken


def noise(*words: object) -> bytes:
    """Return the body of a scan that no other words give, as a NumPy file."""
    return npy(_points(*words))


def noise_digest(*words: object) -> str:
    """Return the digest of that scan, as the service names it."""
    return scan_digest(_points(*words))


def noise_tar(scans: dict[int, tuple[object, ...]]) -> bytes:
    """Return a tar of such scans by index."""
    return tar((f"{index:06}.npy", noise(*words)) for index, words in scans.items())


def _points(*words: object) -> np.ndarray:
    seed = int.from_bytes(hashlib.sha256(repr(words).encode()).digest()[:8])
    return np.random.default_rng(seed).normal(scale=20, size=(_RETURNS, 3)).astype(np.float32)


def driven(index: int) -> Scan:
    """Return a scan of a simulated drive; builds find places in these."""
    return recording(scans=12).scans[index]


def driven_tar(scans: int) -> bytes:
    """Return a tar of the first scans of that drive."""
    return tar((f"{index:06}.bin", kitti(driven(index))) for index in range(scans))


@functools.cache
def map_file(seed: int = 0, *, harmonic: bool = False, scans: int = 24) -> tuple[str, bytes]:
    """Return a revision's digest and its file."""
    make = sample_harmonic_map if harmonic else sample_map
    made, _ = make(scans, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "map.h5")
        write_map(path, made)
        return made.revision, path.read_bytes()


def digest_of_npy(body: bytes) -> str:
    """Return the digest of a scan that the service gave back."""
    points = np.load(io.BytesIO(body), allow_pickle=False)
    return scan_digest(points)


def digest_of_file(body: bytes) -> str:
    """Return the digest of what a revision's file holds, worked out anew."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "downloaded.h5")
        path.write_bytes(body)
        return read_map(path).revision
