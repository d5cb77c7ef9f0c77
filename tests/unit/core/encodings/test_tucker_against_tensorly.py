"""Our model is what TensorLy's HO-SVD gives, up to the signs of eigenvectors."""

import numpy as np
import pytest

from core.encodings.tucker import Grams, leading_basis, project, relative_error
from tests.support.samples import random_images

pytest.importorskip("tensorly")

from tensorly.decomposition import partial_tucker
from tensorly.tenalg import multi_mode_dot

SHAPE, RANKS, SCANS = (30, 61), (5, 5), 80


@pytest.fixture(scope="module")
def images():
    # Of falling singular values, as scans are: leading vectors are well apart.
    rng = np.random.default_rng(5)
    scenes = rng.uniform(5.0, 60.0, size=(8, *SHAPE)) * (0.5 ** np.arange(8))[:, None, None]
    weights = rng.uniform(0.5, 1.0, size=(SCANS, 8))
    noise = random_images(SCANS, SHAPE, seed=2) * np.float32(0.02)
    return np.tensordot(weights, scenes, axes=1).astype(np.float32) + noise


@pytest.fixture(scope="module")
def theirs(images):
    tensor = images.astype(np.float64).transpose(1, 2, 0)  # (I, J, k), the paper's order
    (core_tensor, factors), _ = partial_tucker(
        tensor, rank=list(RANKS), modes=[0, 1], n_iter_max=0, init="svd"
    )
    return core_tensor, factors


@pytest.fixture(scope="module")
def ours(images):
    grams = Grams.of(images)
    u, v = leading_basis(grams.elevation, RANKS[0]), leading_basis(grams.azimuth, RANKS[1])
    return project(images, u, v), u, v


def test_bases_agree_up_to_sign(ours, theirs):
    _, u, v = ours
    for our_basis, their_basis in zip((u, v), theirs[1], strict=True):
        signs = np.sign((our_basis * their_basis).sum(axis=0))
        np.testing.assert_allclose(our_basis, their_basis * signs, atol=1e-9)


def test_signatures_agree_up_to_the_bases_signs(ours, theirs):
    signatures, u, v = ours
    core_tensor, (their_u, their_v) = theirs
    row_signs = np.sign((u * their_u).sum(axis=0))[:, None]
    column_signs = np.sign((v * their_v).sum(axis=0))[None, :]
    expected = core_tensor.transpose(2, 0, 1) * row_signs * column_signs
    np.testing.assert_allclose(signatures, expected, rtol=1e-9, atol=1e-7)


def test_reconstructions_and_errors_agree(images, ours, theirs):
    signatures, u, v = ours
    core_tensor, factors = theirs
    their_model = multi_mode_dot(core_tensor, factors, modes=[0, 1]).transpose(2, 0, 1)
    our_model = np.einsum("ir,nrs,js->nij", u, signatures, v)
    np.testing.assert_allclose(our_model, their_model, atol=1e-8)
    residual = np.linalg.norm(images - their_model) / np.linalg.norm(images)
    assert relative_error(Grams.of(images).squared_norm, signatures) == pytest.approx(
        residual, rel=1e-6
    )
