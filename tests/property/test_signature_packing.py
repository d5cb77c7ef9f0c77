"""A packed signature is unpacked as it was, and any other bytes are rejected."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from core.encodings.signature import Signature, pack_signatures, unpack_signatures
from core.errors import InvalidSignature
from core.projection.visibility import View

REVISION = "0123456789abcdef" * 4
shapes = st.tuples(st.integers(1, 8), st.integers(1, 8))


def signatures_of(shape, bound):
    values = hnp.arrays(np.float32, shape, elements=st.floats(-bound, bound, width=32))
    one = st.builds(Signature, values, st.integers(0, 0xFFFF), st.just(REVISION))
    return st.lists(one, min_size=1, max_size=2)


@given(shapes.flatmap(lambda shape: signatures_of(shape, 65504.0)))
def test_values_within_float16_come_back_to_one_part_in_2048(signatures):
    r1, r2 = signatures[0].values.shape
    body = pack_signatures(signatures)
    assert len(body) == 11 + len(signatures) * (2 + 2 * r1 * r2)
    for sent, got in zip(signatures, unpack_signatures(body), strict=True):
        assert (got.segment, got.revision) == (sent.segment, REVISION[:16])
        np.testing.assert_allclose(got.values, sent.values, rtol=2.0**-11, atol=2.0**-25)


@given(shapes.flatmap(lambda shape: signatures_of(shape, 2.0**109)))
def test_values_beyond_float16_come_back_exactly(signatures):
    if max(np.abs(s.values).max() for s in signatures) <= 65504.0:
        return
    r1, r2 = signatures[0].values.shape
    body = pack_signatures(signatures)
    assert len(body) == 11 + len(signatures) * (2 + 4 * r1 * r2)
    for sent, got in zip(signatures, unpack_signatures(body), strict=True):
        np.testing.assert_array_equal(got.values, sent.values)
        assert got.segment == sent.segment


def sample(**changes):
    parts = {"values": np.ones((5, 5), np.float32), "segment": 3, "revision": REVISION}
    return Signature(**{**parts, **changes})


def test_one_signature_of_5_by_5_is_63_bytes():
    assert len(pack_signatures([sample()])) == 63


@given(st.binary(max_size=200))
def test_any_bytes_are_a_signature_or_rejected(body):
    try:
        signatures = unpack_signatures(body)
    except InvalidSignature:
        return
    assert unpack_signatures(pack_signatures(signatures))[0].revision == signatures[0].revision


@given(st.sampled_from([1, 2]), st.integers(1, 3), st.integers(1, 3), st.integers(1, 3), st.data())
def test_any_values_under_a_true_header_are_finite_or_rejected(layout, r1, r2, count, data):
    size = count * (2 + 2 * layout * r1 * r2)
    body = data.draw(st.binary(min_size=size, max_size=size))
    try:
        signatures = unpack_signatures(bytes([layout]) + bytes(8) + bytes([r1, r2]) + body)
    except InvalidSignature as error:
        assert "not finite" in str(error)  # noqa: PT017  # hypothesis decides whether it is raised
        return
    assert len(signatures) == count
    assert all(np.isfinite(s.values).all() for s in signatures)


@given(st.integers(0, 62))
def test_a_truncated_body_is_rejected(length):
    with pytest.raises(InvalidSignature, match=f", got {length}"):
        unpack_signatures(pack_signatures([sample()])[:length])


@pytest.mark.parametrize(
    ("byte", "value", "message"),
    [(0, 7, "layout 7"), (0, 0, "layout 0"), (9, 0, "0 x 5"), (10, 0, "5 x 0")],
)
def test_an_invalid_header_is_rejected(byte, value, message):
    body = bytearray(pack_signatures([sample()]))
    body[byte] = value
    with pytest.raises(InvalidSignature, match=message):
        unpack_signatures(bytes(body))


@pytest.mark.parametrize(
    ("signatures", "message"),
    [
        ([], "no signature"),
        ([sample(), sample(revision="f" * 64)], "several revisions"),
        ([sample(), sample(values=np.ones((4, 5)))], "several shapes"),
        ([sample(), sample(segment=None, encoding="harmonic")], "several encodings"),
        ([sample(values=np.ones((256, 1)))], "ranks up to 255"),
        ([sample(segment=0x10000)], "segments up to 65535"),
        ([sample(revision="abcd")], "revision"),
        ([sample(revision="not hexadecimal!")], "revision"),
        ([sample(revision="")], "revision"),
    ],
)
def test_a_signature_that_cannot_be_packed_is_rejected(signatures, message):
    with pytest.raises(InvalidSignature, match=message):
        pack_signatures(signatures)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"values": np.ones(5)}, r"shape \(5,\), wanted \(r1, r2\)"),
        ({"values": np.ones((0, 5))}, r"shape \(0, 5\)"),
        ({"values": np.full((5, 5), np.nan)}, "not finite"),
        ({"values": np.full((5, 5), np.inf)}, "not finite"),
        ({"values": np.full((5, 5), 1e300)}, "not finite"),
        ({"values": np.full((5, 5), 1.6e38)}, r"beyond 1e\+33"),
        ({"values": np.full((5, 5), -3.4e38)}, r"beyond 1e\+33"),
        ({"values": np.full((5, 5), 1j)}, "complex values are harmonic, without a segment"),
        ({"values": np.full((5, 5), 1j), "segment": None}, "first column"),
        ({"view": View(hidden=(1,))}, "a paper signature is of a full view"),
        ({"encoding": "harmonic"}, "a harmonic signature has no segment"),
        ({"encoding": "paper", "segment": None}, "a paper signature has a segment"),
        ({"segment": -1}, "segment is -1"),
        ({"segment": 10**30}, "segment is 10000"),
    ],
)
def test_an_invalid_signature_is_rejected(changes, message):
    with pytest.raises(InvalidSignature, match=message):
        sample(**changes)


def test_a_signature_cannot_be_written_through():
    with pytest.raises(ValueError, match="read-only"):
        sample().values[0, 0] = 2.0
