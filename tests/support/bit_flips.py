"""What becomes of a file of which one bit flipped: the same content, or the named error.

    python -m tests.support.bit_flips

flips every single bit of a small file of each kind and prints how that ended.
"""

import hashlib
import resource
import sys
import tempfile
import time
from array import array
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.projection.imager import Imager
from core.projection.reducer import Reducer
from core.scans.scan import Scan
from storage.errors import CorruptFile
from storage.files.drive_chunks import ChunkFile, scan_digest, write_chunk
from storage.files.image_file import ImageFile, write_image_file
from storage.files.map_file import map_of_bytes, write_map
from tests.support.older_files import copied_map, older_chunk
from tests.support.samples import (
    SMALL_GRID,
    FaultyDrive,
    sample_drive,
    sample_harmonic_map,
    sample_map,
)

_IMAGER = Imager(SMALL_GRID, Reducer.LAST)


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        make: Writes a small one at a path.
        read: Returns a digest of its content, read from a path.
    """

    make: Callable[[Path], object]
    read: Callable[[Path], str]


def _scans() -> list[tuple[int, Scan]]:
    rng = np.random.default_rng(1)
    sizes = {4: 5, 9: 0, 2: 20}
    return [
        (i, Scan.from_returns(rng.normal(size=(n, 3)), min_returns=0)) for i, n in sizes.items()
    ]


def _read_map(path: Path) -> str:
    return map_of_bytes(path.read_bytes(), "the file").revision


def _read_chunk(path: Path) -> str:
    file = ChunkFile(path)
    return " ".join(scan_digest(file.points_m(row)) for row in range(3))


def _read_images(path: Path) -> str:
    """Read all that a build reads but the reasons why scans were skipped, which are words."""
    with ImageFile(path, _IMAGER) as images:
        parts: list[NDArray[Any]] = [
            images.scans,
            images.probed,
            images.displacement,
            images.read(0, len(images)),
        ]
        if images.probes is not None:
            parts.append(images.probes.read(0, len(images.probes)))
        counts = [images.returns, len(images.skipped)]
    return hashlib.sha256(repr(counts).encode() + b"".join(p.tobytes() for p in parts)).hexdigest()


def _drive() -> FaultyDrive:
    return FaultyDrive(sample_drive(9), {3})


KINDS = {
    "map": Kind(lambda p: write_map(p, sample_map(count=3, segment_length=3)[0]), _read_map),
    "harmonic map": Kind(
        lambda p: write_map(p, sample_harmonic_map(count=3, segment_length=3)[0]), _read_map
    ),
    "copied map": Kind(
        lambda p: copied_map(p, sample_map(count=3, segment_length=3)[0]), _read_map
    ),
    "chunk": Kind(lambda p: write_chunk(p, _scans()), _read_chunk),
    "older chunk": Kind(lambda p: older_chunk(p, _scans()), _read_chunk),
    "images": Kind(lambda p: write_image_file(p, _drive(), _IMAGER), _read_images),
}
"""Files as they are written now, and as they were or are copied."""


def flipped(
    kind: Kind, path: Path, bits: Iterable[int], spent: Callable[[float], object]
) -> Counter[str]:
    """Flip single bits of the file at `path`, one at a time, and count how reading it ended.

    Args:
        kind: Its kind.
        path: A whole file; it is whole again at the end.
        bits: Which.
        spent: Is given the seconds of each reading.

    Returns:
        How often it was `the same`, `refused`, or `other content`; any other exception passes.
    """
    whole, content = path.read_bytes(), kind.read(path)
    ended: Counter[str] = Counter()
    for bit in bits:
        harmed = bytearray(whole)
        harmed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(harmed)
        begun = time.perf_counter()
        try:
            ended["the same" if kind.read(path) == content else "other content"] += 1
        except CorruptFile:
            ended["refused"] += 1
        spent(time.perf_counter() - begun)
    path.write_bytes(whole)
    return ended


def main(names: list[str]) -> None:
    """Flip all bits of a file of each kind, or of those that are named."""
    with tempfile.TemporaryDirectory() as folder:
        for name in names or KINDS:
            path, seconds = Path(folder, "file.h5"), array("d")
            path.unlink(missing_ok=True)
            KINDS[name].make(path)
            count = 8 * path.stat().st_size
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            ended = flipped(KINDS[name], path, range(count), seconds.append)
            grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
            sys.stdout.write(
                f"{name}: {count} flips, {dict(ended)}, at most {1e3 * max(seconds):.0f} ms each,"
                f" memory grew by {grown // 1024} MB\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
