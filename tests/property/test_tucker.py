"""The laws of the orthogonal Tucker model (paper, sec. 2.2)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.encodings.tucker import Grams, leading_basis, project, relative_error
from core.errors import InvalidParameters
from tests.support.samples import random_images

tensors = st.builds(
    lambda count, rows, columns, seed: random_images(count, (rows, columns), seed),
    count=st.integers(1, 70),  # more than two blocks
    rows=st.integers(1, 9),
    columns=st.integers(1, 13),
    seed=st.integers(0, 10_000),
)
# Full of ties and rank-deficient Grams: bases are not unique there, but still must be orthonormal.
degenerate_tensors = st.builds(
    lambda count, rows, columns, seed: (
        np.random.default_rng(seed).integers(0, 2, size=(count, rows, columns)).astype(np.float32)
    ),
    count=st.integers(1, 4),
    rows=st.integers(1, 9),
    columns=st.integers(1, 13),
    seed=st.integers(0, 10_000),
)


def fit(images, r1, r2):
    grams = Grams.of(images)
    return leading_basis(grams.elevation, r1), leading_basis(grams.azimuth, r2)


def reconstruct(signatures, u, v):
    return np.einsum("ir,nrs,js->nij", u, signatures, v)


def squared(array):
    return float(np.square(array.astype(np.float64)).sum())


@given(st.one_of(tensors, degenerate_tensors), st.data())
def test_the_bases_are_orthonormal(images, data):
    _, rows, columns = images.shape
    r1, r2 = data.draw(st.integers(1, rows)), data.draw(st.integers(1, columns))
    u, v = fit(images, r1, r2)
    np.testing.assert_allclose(u.T @ u, np.eye(r1), atol=1e-10)
    np.testing.assert_allclose(v.T @ v, np.eye(r2), atol=1e-10)


@given(st.one_of(tensors, degenerate_tensors))
def test_full_rank_reconstructs_exactly(images):
    _, rows, columns = images.shape
    u, v = fit(images, rows, columns)
    signatures = project(images, u, v)
    np.testing.assert_allclose(reconstruct(signatures, u, v), images, atol=1e-10)
    assert relative_error(Grams.of(images).squared_norm, signatures) < 1e-6


@given(tensors)
def test_the_error_never_rises_with_either_rank(images):
    _, rows, columns = images.shape
    norm = Grams.of(images).squared_norm
    u, v = fit(images, rows, columns)
    error = np.array(
        [
            [relative_error(norm, project(images, u[:, :r1], v[:, :r2])) for r2 in (1, columns)]
            for r1 in range(1, rows + 1)
        ]
    )
    assert (np.diff(error, axis=0) <= 1e-7).all()
    assert (np.diff(error, axis=1) <= 1e-7).all()


@given(tensors, st.data())
def test_a_smaller_basis_is_the_beginning_of_a_larger_one(images, data):
    grams = Grams.of(images)
    values = np.linalg.eigvalsh(grams.elevation)[::-1]
    rank = data.draw(st.integers(1, len(values)))
    if rank < len(values) and values[rank - 1] - values[rank] < 1e-6 * values[0]:
        return  # an eigenvalue met twice has no one basis
    small, large = leading_basis(grams.elevation, rank), leading_basis(grams.elevation, len(values))
    np.testing.assert_allclose(small @ small.T, large[:, :rank] @ large[:, :rank].T, atol=1e-6)


@given(tensors, st.randoms(use_true_random=False), st.data())
def test_grams_do_not_depend_on_order_or_blocks(images, random, data):
    whole = Grams.of(images)
    order = list(range(len(images)))
    random.shuffle(order)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(images)), max_size=5)))
    total = Grams.zero(images.shape[1:])
    for start, stop in zip([0, *cuts], [*cuts, len(images)], strict=True):
        total += Grams.of(images[order][start:stop])
    assert total.scans == whole.scans == len(images)
    np.testing.assert_allclose(total.elevation, whole.elevation, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(total.azimuth, whole.azimuth, rtol=1e-10, atol=1e-10)
    assert total.squared_norm == pytest.approx(whole.squared_norm, rel=1e-10)


def test_streaming_gives_the_bases_and_signatures_of_the_batch_to_1e_10():
    images = random_images(100, (8, 11), seed=3)
    batch = Grams.of(images)
    streamed = Grams.zero((8, 11))
    for image in images[np.random.default_rng(0).permutation(100)]:
        streamed += Grams.of(image[None])
    for rank in (1, 4, 8):
        u = leading_basis(batch.elevation, rank)
        v = leading_basis(batch.azimuth, rank)
        np.testing.assert_allclose(leading_basis(streamed.elevation, rank), u, atol=1e-10)
        np.testing.assert_allclose(leading_basis(streamed.azimuth, rank), v, atol=1e-10)
        one_by_one = np.concatenate([project(image[None], u, v) for image in images])
        np.testing.assert_allclose(one_by_one, project(images, u, v), rtol=1e-10, atol=1e-9)


@given(tensors)
def test_grams_are_the_sums_that_the_paper_names(images):
    exact = images.astype(np.float64)
    grams = Grams.of(images)
    np.testing.assert_allclose(grams.elevation, np.einsum("nij,nkj->ik", exact, exact))
    np.testing.assert_allclose(grams.azimuth, np.einsum("nij,nik->jk", exact, exact))
    assert grams.squared_norm == pytest.approx(np.trace(grams.azimuth)) == squared(images)


@given(tensors)
def test_the_largest_entry_of_every_column_is_positive(images):
    for basis in fit(images, images.shape[1], images.shape[2]):
        largest = basis[np.abs(basis).argmax(axis=0), np.arange(basis.shape[1])]
        assert (largest > 0).all()


@given(tensors)
def test_negated_images_change_nothing_in_the_bases_and_the_sign_of_the_signatures(images):
    _, rows, columns = images.shape
    r1, r2 = min(rows, 3), min(columns, 3)
    u, v = fit(images, r1, r2)
    negated_u, negated_v = fit(-images, r1, r2)
    np.testing.assert_array_equal(u, negated_u)
    np.testing.assert_array_equal(v, negated_v)
    np.testing.assert_array_equal(project(-images, u, v), -project(images, u, v))


@given(tensors, st.data())
def test_the_relative_error_is_that_of_the_reconstruction(images, data):
    _, rows, columns = images.shape
    u, v = fit(images, data.draw(st.integers(1, rows)), data.draw(st.integers(1, columns)))
    signatures = project(images, u, v)
    direct = np.sqrt(squared(images - reconstruct(signatures, u, v)) / squared(images))
    assert relative_error(Grams.of(images).squared_norm, signatures) == pytest.approx(
        direct, abs=1e-7
    )


@given(tensors)
def test_projecting_agrees_with_the_formula(images):
    u, v = fit(images, min(3, images.shape[1]), min(4, images.shape[2]))
    expected = np.einsum("ir,nij,js->nrs", u, images.astype(np.float64), v)
    np.testing.assert_allclose(project(images, u, v), expected, rtol=1e-10, atol=1e-10)


@settings(max_examples=20)
@given(tensors)
def test_the_same_images_give_the_same_bases_to_the_bit(images):
    for one, other in zip(fit(images, 1, 1), fit(images.copy(), 1, 1), strict=True):
        np.testing.assert_array_equal(one, other)


def test_no_other_basis_of_that_rank_keeps_more():
    images = random_images(40, (8, 12), seed=1)
    u, v = fit(images, 3, 4)
    rng = np.random.default_rng(0)
    for _ in range(20):
        other_u, _ = np.linalg.qr(rng.normal(size=(8, 3)))
        other_v, _ = np.linalg.qr(rng.normal(size=(12, 4)))
        assert squared(project(images, other_u, np.eye(12))) <= squared(
            project(images, u, np.eye(12))
        )
        assert squared(project(images, np.eye(8), other_v)) <= squared(
            project(images, np.eye(8), v)
        )


def test_images_of_nothing_have_no_error():
    assert relative_error(0.0, np.zeros((2, 3, 3))) == 0.0
    assert relative_error(1.0, np.full((1, 1, 1), 1.0 + 1e-12)) == 0.0


@pytest.mark.parametrize("rank", [-1, 0, 4, 10**9])
def test_a_rank_beyond_the_matrix_is_rejected(rank):
    with pytest.raises(InvalidParameters, match=rf"the rank is {rank}, wanted 1\.\.3"):
        leading_basis(np.eye(3), rank)
