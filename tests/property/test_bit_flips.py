"""A file with one flipped bit is read as it was, or rejected with a named error, in bounded work.

`python -m tests.support.bit_flips` does the same to every single bit.
"""

import numpy as np
import pytest

from storage.hdf5 import source
from tests.support.bit_flips import KINDS, flipped

pytestmark = pytest.mark.slow

FLIPS = 400
SEED = 20261122


@pytest.mark.parametrize("name", KINDS)
def test_one_flipped_bit_is_without_effect_or_rejected(tmp_path, monkeypatch, name):
    path, kind = tmp_path / "file.h5", KINDS[name]
    kind.make(path)
    size, read = path.stat().st_size, [0]
    seeing(monkeypatch, read)

    def require_bounded(_seconds: float) -> None:
        assert read[0] <= 4 * size + source._STRUCTURE_BYTES
        read[0] = 0

    bits = np.random.default_rng(SEED).integers(0, 8 * size, FLIPS).tolist()
    ended = flipped(kind, path, bits, require_bounded)
    assert ended["refused"] > FLIPS // 20
    if "chunk" not in name:  # the digest of returns is in the catalog, where `ScanReader` checks it
        assert not ended["other content"], ended


def seeing(monkeypatch, read):
    """Count the bytes that are read."""
    for of in (source.BytesSource, source.FileSource):

        def counted(self, at, target, _inner=of._read_into):
            read[0] += len(target)
            return _inner(self, at, target)

        monkeypatch.setattr(of, "_read_into", counted)
