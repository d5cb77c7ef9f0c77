"""Compressed bodies: bounded members and ratios."""

import gzip
from collections.abc import Callable

import numpy as np
import pytest
import zstandard

from app.http.bodies.content_encoding import decoder_of
from app.http.errors import BodyTooLarge, MalformedBody

PACK: dict[str, Callable[[bytes], bytes]] = {"gzip": gzip.compress, "zstd": zstandard.compress}


def unpacked(body: bytes, encoding: str, step: int = 50_000) -> int:
    decoder = decoder_of(encoding)
    assert decoder is not None
    count = 0
    for start in range(0, len(body), step):
        count += sum(len(piece) for piece in decoder.feed(body[start : start + step]))
    decoder.finish()
    return count


@pytest.mark.parametrize("encoding", PACK)
class TestPackedBodies:
    def test_empty_members_are_bounded(self, encoding: str) -> None:
        assert unpacked(PACK[encoding](b"") * 900, encoding) == 0
        with pytest.raises(MalformedBody, match="more than 1000 members"):
            unpacked(PACK[encoding](b"") * 1100, encoding)

    def test_members_as_bgzip_makes_them_are_not(self, encoding: str) -> None:
        block = np.random.default_rng(0).bytes(16 * 2**10)
        assert unpacked(PACK[encoding](block) * 2000, encoding) == 2000 * len(block)

    def test_a_body_that_unpacks_to_200_times_its_size_is_rejected_once_it_is_large(
        self, encoding: str
    ) -> None:
        assert unpacked(PACK[encoding](bytes(16 * 2**20)), encoding) == 16 * 2**20
        with pytest.raises(BodyTooLarge, match="more than 200 times its size"):
            unpacked(PACK[encoding](bytes(80 * 2**20)), encoding)
