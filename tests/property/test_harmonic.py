"""The algebra of the harmonic encoding: yaw is a phase, the bound is one, the norm is energy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.encodings.distance import Distance
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonic.query_limits import narrowed
from core.encodings.harmonics import azimuth_factor, encode, energy, weights
from core.encodings.signature import Packing, Signature, pack_signatures, unpack_signatures
from core.encodings.tucker import leading_basis, row_gram
from core.projection.visibility import SECTORS, View

pytestmark = pytest.mark.slow

REVISION = "0123456789abcdef" * 4
ROWS, COLUMNS = 6, 24

seeds = st.integers(0, 2**32 - 1)
measures = st.sampled_from(list(Distance))


def images_of(seed, count, columns=COLUMNS):
    """Return images with one bright cell in each, so that the relative yaw is unique."""
    rng = np.random.default_rng(seed)
    images = rng.uniform(0.0, 1.0, size=(count, ROWS, columns))
    images[np.arange(count), rng.integers(0, ROWS, count), rng.integers(0, columns, count)] = 9.0
    return images


def model_of(seed, scans, renderings, r2=5, measure=Distance.NORMALISED, twins=False):
    images = images_of(seed, scans * renderings)
    if twins:
        images[:] = images[
            np.random.default_rng(seed).integers(0, min(2, len(images)), len(images))
        ]
    u = leading_basis(row_gram(images), 3).astype(np.float32)
    signatures = encode(images, u, r2).reshape(scans, renderings, 3, r2)
    return HarmonicModel(
        u,
        SignatureNumbers(signatures.astype(np.complex64)),
        np.arange(renderings) - renderings // 2,
        np.array([0, scans]),
        COLUMNS,
        measure,
        (3, r2),
    )


def query(model, image):
    values = encode(image, model.radial_basis, model.ranks[1]).astype(np.complex64)
    return model.search([Signature(values, None, REVISION)])


@given(seeds, st.integers(1, COLUMNS // 2 + 1))
def test_the_first_column_is_real_and_so_is_the_one_of_half_the_columns(seed, r2):
    [image] = images_of(seed, 1)
    u = leading_basis(row_gram(image[None]), 3)
    signature = encode(image, u, r2)
    assert not signature[:, 0].imag.any()
    if r2 == COLUMNS // 2 + 1:
        assert not signature[:, -1].imag.any()


@given(st.integers(1, 40).map(lambda half: 2 * half), st.data())
def test_the_harmonics_are_orthonormal_and_all_of_them_keep_all_the_energy(columns, data):
    r2 = data.draw(st.integers(1, columns // 2 + 1))
    factor = azimuth_factor(columns, r2)
    np.testing.assert_allclose(factor.conj().T @ factor, np.eye(r2), atol=1e-12)
    assert weights(columns, columns // 2 + 1).sum() == columns
    images = np.random.default_rng(0).normal(size=(3, ROWS, columns))
    whole = encode(images, np.eye(ROWS), columns // 2 + 1)
    np.testing.assert_allclose(energy(whole, columns), np.square(images).sum(axis=(1, 2)))


@given(seeds, st.integers(-COLUMNS, COLUMNS))
def test_a_yaw_of_s_columns_multiplies_harmonic_m_by_a_phase(seed, s):
    [image] = images_of(seed, 1)
    u = leading_basis(row_gram(image[None]), 3)
    rolled = np.roll(image, -s, axis=1)  # counter-clockwise: column s is now ahead
    np.testing.assert_allclose(row_gram(rolled[None]), row_gram(image[None]), rtol=1e-12)
    phases = np.exp(2j * np.pi * np.arange(5) * s / COLUMNS)
    np.testing.assert_allclose(encode(rolled, u, 5), encode(image, u, 5) * phases, atol=1e-9)


@given(seeds, st.integers(-COLUMNS // 2 + 1, COLUMNS // 2), measures)
def test_the_correlation_finds_the_relative_yaw_of_a_scan_of_the_map(seed, s, measure):
    images = images_of(seed, 8)
    u = leading_basis(row_gram(images), 3).astype(np.float32)
    signatures = SignatureNumbers(encode(images, u, 5)[:, None].astype(np.complex64))
    start = np.array([0, 8])
    model = HarmonicModel(u, signatures, np.zeros(1), start, COLUMNS, measure, (3, 5))
    found = query(model, np.roll(images[3], -s, axis=1)).nearest(1)
    assert found.rows.tolist() == [3]
    error = (found.relative_yaw_deg[0] - s * 360 / COLUMNS + 180) % 360 - 180
    assert abs(error) < 0.2
    scale = 1.0 if measure == Distance.NORMALISED else float(model.renderings.norms[3, 0]) ** 2
    assert found.distances[0] < 1e-3 * scale


@given(seeds, st.integers(1, 40), st.integers(1, 3), st.integers(1, 45), measures, st.booleans())
def test_pruned_is_brute_force_to_the_bit(seed, scans, renderings, k, measure, twins):
    model = model_of(seed, scans, renderings, measure=measure, twins=twins)
    search = query(model, images_of(seed + 1, 1)[0])
    everything = search.ranked(np.arange(scans), *search.exact(np.arange(scans)), scans)
    assert_alike(search.nearest(k), everything[:k])
    among = np.random.default_rng(seed).random(scans) < 0.4
    expected = everything[among[everything.rows]]
    assert_alike(search.nearest(k, among), expected[:k])


@pytest.mark.parametrize("measure", list(Distance))
@pytest.mark.parametrize("k", [1, 5])
def test_pruned_in_several_steps_is_brute_force_to_the_bit_too(k, measure, monkeypatch):
    for name in ("FIRST", "_AT_ONCE"):
        monkeypatch.setattr(f"core.encodings.harmonic.search.{name}", 1)
    for seed in range(20):
        model = model_of(seed, 60, 2, measure=measure)
        search = query(model, images_of(seed + 1, 1)[0])
        everything = search.ranked(np.arange(60), *search.exact(np.arange(60)), k)
        assert_alike(search.nearest(k), everything)


def assert_alike(found, expected):
    for name in ("rows", "distances", "relative_yaw_deg", "lateral_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@given(seeds, measures)
def test_no_rendering_is_nearer_than_its_bound(seed, measure):
    model = model_of(seed, 20, 3, measure=measure)
    search = query(model, images_of(seed + 1, 1)[0])
    distances, _ = search.exact(np.arange(20))
    assert (search._lower_bounds <= distances.min(axis=1)).all()


@given(seeds)
def test_the_best_correlation_over_yaws_is_that_of_a_fine_grid_of_yaws(seed):
    model = model_of(seed, 6, 1, measure=Distance.PLAIN)
    image = images_of(seed + 1, 1)[0]
    g = encode(image, model.radial_basis, 5)
    m, w = np.arange(5), weights(COLUMNS, 5)
    yaws = np.exp(2j * np.pi * np.outer(np.arange(3600) / 3600, m))
    distances, _ = query(model, image).exact(np.arange(6))
    for row in range(6):
        G = model.signatures[row, 0].astype(np.complex128)
        best = (yaws @ (w * (g * G.conj()).sum(axis=0))).real.max()
        both = float(energy(g, COLUMNS)) + float(energy(G, COLUMNS))
        assert distances[row, 0] == pytest.approx(both - 2 * best, rel=1e-3, abs=1e-3 * both)


@given(seeds, st.floats(0.01, 100.0))
def test_the_normalised_distance_does_not_depend_on_the_querys_scale(seed, scale):
    model = model_of(seed, 10, 2)
    image = images_of(seed + 1, 1)[0]
    one, other = query(model, image).nearest(10), query(model, scale * image).nearest(10)
    np.testing.assert_allclose(one.distances, other.distances, atol=1e-5, rtol=1e-4)


def test_a_signature_of_nothing_is_near_to_nothing():
    model = model_of(0, 5, 2)
    found = model.search([Signature(np.zeros((3, 5), np.complex64), None, REVISION)]).nearest(5)
    assert found.distances.tolist() == [1.0] * 5


def test_one_harmonic_has_no_relative_yaw():
    model = model_of(0, 5, 2, r2=1)
    found = query(model, images_of(0, 1)[0]).nearest(1)
    assert np.isnan(found.relative_yaw_deg).all()


harmonic_signatures = st.builds(
    lambda seed, r1, r2, scale: _random_signature(seed, r1, r2, scale),
    seeds,
    st.integers(1, 8),
    st.integers(1, 8),
    st.floats(1e-3, 1e4),
)


def _random_signature(seed, r1, r2, scale):
    rng = np.random.default_rng(seed)
    values = scale * (rng.uniform(-1, 1, (r1, r2)) + 1j * rng.uniform(-1, 1, (r1, r2)))
    values[:, 0] = values[:, 0].real
    return Signature(values.astype(np.complex64), None, REVISION)


@given(harmonic_signatures)
def test_float16_is_exact_to_one_part_in_2048(signature):
    r1, r2 = signature.values.shape
    body = pack_signatures([signature], Packing.FLOAT16)
    assert len(body) == 11 + 2 * r1 * (2 * r2 - 1)
    [got] = unpack_signatures(body)
    assert (got.segment, got.revision) == (None, REVISION[:16])
    for part in ("real", "imag"):
        np.testing.assert_allclose(
            getattr(got.values, part), getattr(signature.values, part), rtol=2.0**-11, atol=2.0**-24
        )


@given(harmonic_signatures)
def test_roots_of_int8_come_back_to_half_a_step_of_the_largest(signature):
    r1, r2 = signature.values.shape
    body = pack_signatures([signature])
    assert len(body) == 11 + 4 + r1 * (2 * r2 - 1)
    [got] = unpack_signatures(body)
    largest = max(np.abs(signature.values.real).max(), np.abs(signature.values.imag).max())
    for part in ("real", "imag"):
        came, sent = getattr(got.values, part), getattr(signature.values, part)
        assert (np.sign(came) * np.sign(sent) >= 0).all()
        error = np.sqrt(np.abs(came)) - np.sqrt(np.abs(sent))
        assert np.abs(error).max() <= 0.501 * np.sqrt(largest) / 127
    again = unpack_signatures(pack_signatures([got]))[0]
    np.testing.assert_allclose(again.values, got.values, rtol=1e-5)


@given(seeds, st.integers(1, 12), st.integers(1, 3), st.integers(1, COLUMNS // 2 + 1), measures)
def test_distances_for_a_belief_are_those_of_all_headings(seed, scans, renderings, r2, measure):
    model = model_of(seed, scans, renderings, r2, measure)
    search = query(model, images_of(seed + 1, 1)[0])
    exact = search.distances()
    atol = 1e-4 * max(1.0, float(exact.max()))  # of two headings that are as alike, either
    np.testing.assert_allclose(search.distances_for_belief(), exact, atol=atol)


@given(st.sets(st.integers(0, SECTORS - 1)), st.integers(0, SECTORS - 1), st.integers(0, 10_000))
def test_a_narrowed_scan_sees_a_part_of_what_it_saw_and_no_more_than_the_view(own, hidden, turned):
    found = narrowed(own, View(tuple(range(hidden))), turned)
    if found is None:
        assert len(own) == SECTORS
        return
    assert own <= set(found)
    assert SECTORS - len(found) == min(SECTORS - len(own), SECTORS - hidden)
