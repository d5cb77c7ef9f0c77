"""The paper's own figures, and where it and its method part."""

import numpy as np
import pytest

from core.encodings.compression import Compression
from core.encodings.signature import Signature, pack_signatures
from core.encodings.tucker import Grams, leading_basis, project, storage_elements
from core.parameters import MapParameters
from core.projection.range_image import project_scan
from core.projection.reducer import Reducer
from core.scans.sensor import HDL_64E, AngularGrid
from core.segmentation.fixed import PAPER_SEGMENT_LENGTH, cut_fixed, segment_length_for
from core.simulation import SimulatedDrive

K, RETURNS = 3800, 77_000


def test_a_scan_becomes_a_matrix_of_30_by_361():
    assert AngularGrid().shape == HDL_64E.grid.shape == (30, 361)
    assert AngularGrid().elevations_deg[[0, -1]].tolist() == [-25.0, 4.0]
    assert AngularGrid().azimuths_deg[[0, 180, -1]].tolist() == [-180.0, 0.0, 180.0]


def test_the_parameters_are_the_papers_by_default():
    assert MapParameters().ranks == (5, 5)
    assert MapParameters().grid == AngularGrid()
    assert MapParameters().reducer is Reducer.LAST


def test_3800_scans_make_5_segments_of_760():
    starts = cut_fixed(K, segment_length_for(K))
    assert starts.tolist() == [0, 760, 1520, 2280, 3040, 3800]
    assert segment_length_for(K, segments=5) == PAPER_SEGMENT_LENGTH == 760


def test_the_map_of_the_paper_holds_104_775_numbers():
    assert storage_elements(5, K, (30, 361), (5, 5)) == 104_775
    assert 5 * (30 * 5 + 361 * 5) + K * 5 * 5 == 104_775


def test_compression_is_about_1_to_400_to_8300():
    found = Compression.of(104_775, scans=K, grid_shape=(30, 361), returns=K * RETURNS)
    assert found.tensor_ratio == pytest.approx(392.8, abs=0.05)
    assert found.returns_ratio == pytest.approx(8378, abs=0.5)
    assert round(found.tensor_ratio, -2) == 400
    assert found.returns_ratio == pytest.approx(8300, rel=0.01)


@pytest.mark.parametrize("k", [50, 100, 200, 475, 760])
def test_longer_segments_need_less_storage(k):
    assert K % k == 0
    shorter, longer = (storage_elements(K // n, K, (30, 361), (5, 5)) for n in (k, 2 * k))
    assert longer < shorter


def test_a_signature_is_sent_in_63_bytes():
    one = Signature(np.ones((5, 5), np.float32), segment=0, revision="ab" * 32)
    assert len(pack_signatures([one])) == 63


@pytest.fixture(scope="module")
def simulated_signatures():
    drive = SimulatedDrive(seed=4, scans=60, stops=False)
    images = np.stack([project_scan(drive.scan(i), AngularGrid(), Reducer.LAST) for i in range(60)])
    grams = Grams.of(images)
    return project(images, leading_basis(grams.elevation, 5), leading_basis(grams.azimuth, 5))


def cosines(signatures):
    flat = signatures.reshape(len(signatures), -1)
    flat = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    return flat @ flat.T


def test_the_slices_of_neighbouring_scans_are_nearly_parallel_not_orthogonal(simulated_signatures):
    # The paper calls the slices orthogonal (sec. 2.3). With W = I they are not.
    assert np.median(np.diagonal(cosines(simulated_signatures), offset=1)) > 0.9


def test_the_slices_of_a_segment_cannot_all_be_orthogonal(simulated_signatures):
    # They lie in a space of r1 r2 dimensions, which holds no more orthogonal non-zero ones.
    scans, r1, r2 = simulated_signatures.shape
    assert scans > r1 * r2
    gram = cosines(simulated_signatures)
    assert np.linalg.matrix_rank(gram) <= r1 * r2
    assert np.abs(gram - np.eye(scans)).max() > 0.0


def test_with_a_third_factor_the_core_is_all_orthogonal(simulated_signatures):
    # What the paper cites is true of the full HO-SVD, whose slices are no longer scans.
    flat = simulated_signatures.reshape(len(simulated_signatures), -1)
    w, _, _ = np.linalg.svd(flat, full_matrices=False)
    slices = w.T @ flat
    inner = slices @ slices.T
    np.testing.assert_allclose(inner - np.diag(np.diag(inner)), 0.0, atol=1e-6 * inner[0, 0])
