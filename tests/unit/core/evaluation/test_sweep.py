"""The sweep answers as maps do that are built one by one."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.encodings.harmonic.model import HarmonicModel
from core.encodings.paper.encoding import leading_sums
from core.encodings.paper.model import PaperModel
from core.encodings.registry import encoding_named, encoding_names
from core.encodings.signature import pack_signatures
from core.errors import InvalidParameters
from core.evaluation.condition import Condition
from core.evaluation.criterion import Criterion
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.query_set import QuerySet
from core.evaluation.split import Every, Interleaved
from core.evaluation.study_drive import held_out_scans
from core.evaluation.sweep import QueryImages, SweepGrid, sweep
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.mapping.pipeline import build, build_map
from core.parameters import MapParameters
from core.progress import NO_PROGRESS
from core.projection.imager import Views
from core.projection.images import MemoryImages
from core.projection.visibility import SECTORS, hide
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from core.segmentation.fixed import cut_fixed
from tests.support.recording import recording
from tests.support.samples import (
    SMALL_GRID,
    random_images,
    sample_image,
    straight_poses,
    trajectory,
)

pytestmark = pytest.mark.slow

GRID = SweepGrid(r1=(2, 3, 5), r2=(2, 4, 5), segment_lengths=(10, 25))
CONDITIONS = (Condition(), Condition(lateral_m=1.0))


@functools.cache
def drive(scans=40):
    return MemoryDrive("d", recording(scans=scans).scans)


def parameters(encoding, ranks=(5, 5)):
    return MapParameters.for_sensor(
        encoding=encoding,
        ranks=ranks,
        lateral_renderings_m=(-1.5, 0.0, 1.5) if encoding == "harmonic" else None,
        verification_images=False,  # a sweep is of signatures
    )


@functools.cache
def images_of(encoding, recorded=None, split=None, most=None):
    recorded = recorded or drive()
    held_out, queried = held_out_scans(recorded, split or Interleaved(), most or 10**6)
    queries = QuerySet(recorded, queried, CONDITIONS, 0)
    return QueryImages.of_drive(held_out, queries, parameters(encoding))


@functools.cache
def swept(encoding):
    return sweep(images_of(encoding), criterion(), GRID)


def criterion(recorded=None, **options):
    recorded = recorded or drive()
    return Criterion(recorded.poses, recorded.timestamp_s, **options)


@pytest.mark.parametrize("encoding", encoding_names())
def test_signatures_of_small_ranks_are_the_leading_block_of_those_of_large_ones(encoding) -> None:
    of = images_of(encoding)
    small, large = (
        build(
            [drive()],
            parameters(encoding, ranks),
            lambda _: of.mapped,
            segment_start=cut_fixed(len(drive()), 10),
            calibrated=False,
        ).tensor_map.model
        for ranks in ((3, 4), (5, 8))
    )
    r1, r2 = small.ranks
    block = large.signatures[..., :r1, :r2]
    np.testing.assert_allclose(block, small.signatures, atol=1e-3 * np.abs(block).max())
    if isinstance(small, PaperModel) and isinstance(large, PaperModel):
        np.testing.assert_allclose(large.azimuth_basis[..., :4], small.azimuth_basis, atol=1e-5)
    if isinstance(small, HarmonicModel) and isinstance(large, HarmonicModel):
        np.testing.assert_allclose(large.radial_basis[:, :r1], small.radial_basis, atol=1e-5)


@pytest.mark.parametrize("encoding", encoding_names())
@pytest.mark.parametrize(("ranks", "k"), [((2, 4), 10), ((5, 5), 10), ((5, 2), 25)])
def test_a_candidate_has_the_figures_that_evaluate_finds(encoding, ranks, k) -> None:
    found = swept(encoding).at(ranks, k)
    assert found is not None
    expected = evaluate(
        drive(),
        EvaluationProtocol(parameters(encoding, ranks), segment_length=k, conditions=CONDITIONS),
    )
    assert found.segments == expected.segments
    assert found.elements == expected.compression.elements
    stored = encoding_named(encoding).stored_bytes(
        parameters(encoding, ranks), found.segments, expected.map_scans
    )
    assert found.bytes_per_scan == stored / expected.map_scans
    assert found.segment_accuracy == expected.conditions[0].segment_accuracy
    assert found.accuracy == tuple(row.recall_at_1[3.0] for row in expected.conditions)
    assert min(expected.relative_error) <= found.relative_error <= max(expected.relative_error)


def test_a_narrow_view_is_compared_by_the_numbers_that_a_vehicle_sends_of_it() -> None:
    rng = np.random.default_rng(3)
    of = replace(parameters("harmonic", (6, 7)), views=Views.ANY)
    depth, rows, columns = of.imager.shape
    one_view = random_images(60, (rows, columns))[:, None]
    images = MemoryImages(np.repeat(one_view, depth, axis=1), of.grid)
    noisy = np.maximum(one_view[:, 0] + rng.normal(scale=15.0, size=one_view[:, 0].shape), 0.1)
    narrow = [hide(cells.astype(np.float32), np.arange(SECTORS) >= 40) for cells in noisy]
    cuts, every = np.array([0, 60]), np.ones(60, bool)
    found, _ = of.encoder.rank_sweep(
        images, np.array(narrow), [cuts], ((6,), (7,)), of, NO_PROGRESS, every
    )
    tensor_map = fit_map(images, trajectory(straight_poses(60)), cuts, of)
    model, basis = tensor_map.model, tensor_map.basis()
    asked = [sample_image(tensor_map, cells) for cells in narrow]
    sent = [basis.encode(image)[0].values for image in asked]
    assert {np.shape(values) for values in sent} == {(8, 5)}
    expected = [int(model.search_image(image, basis).nearest(1).rows[0]) for image in asked]
    assert expected != list(range(60))
    differ = found[0, :, 0, 0] != expected
    assert differ.sum() <= 2  # a map's numbers are rounded to bytes


def test_scans_that_are_nearly_equally_near_are_told_apart_as_in_a_map() -> None:
    """Of a stationary vehicle: in single precision the distances of its scans would be equal."""
    base, others = random_images(1, SMALL_GRID.shape), random_images(60, SMALL_GRID.shape, seed=1)
    noise = np.random.default_rng(2).normal(scale=2e-5, size=(40, *SMALL_GRID.shape))
    images = MemoryImages((base + noise).astype(np.float32), SMALL_GRID)
    of = MapParameters(grid=SMALL_GRID, ranks=(3, 4))
    cuts = np.array([0, 20, 40])
    every = np.ones(40, bool)
    rows, _ = of.encoder.rank_sweep(images, others, [cuts], ((3,), (4,)), of, NO_PROGRESS, every)
    tensor_map = fit_map(images, trajectory(straight_poses(40)), cuts, of)
    model, basis = tensor_map.model, tensor_map.basis()
    expected = [
        model.search_values(basis.project(image), basis.view(image)).nearest(1).rows[0]
        for image in (sample_image(tensor_map, cells) for cells in others)
    ]
    assert rows[0, :, 0, 0].tolist() == expected


def test_of_a_stand_one_scan_counts_in_the_basis_of_a_sweep_as_in_that_of_a_map() -> None:
    scans = list(drive())
    waiting = [replace(scan, pose=scans[10].pose) for scan in scans[10:34]]
    stood = MemoryDrive("d", [*scans[:10], *waiting, *scans[34:]])
    found = sweep(images_of("harmonic", stood), criterion(stood), GRID).at((5, 5), 10)
    assert found is not None
    expected = evaluate(stood, EvaluationProtocol(parameters("harmonic"), segment_length=10))
    assert min(expected.relative_error) <= found.relative_error <= max(expected.relative_error)


@pytest.mark.parametrize("encoding", encoding_names())
def test_larger_ranks_leave_a_smaller_error_and_take_more_bytes(encoding) -> None:
    points = swept(encoding).points
    assert len(points) == 3 * 3 * 2
    for one in points:
        for two in points:
            if one.segment_length == two.segment_length and all(
                np.less_equal(one.ranks, two.ranks)
            ):
                assert one.relative_error >= two.relative_error - 1e-12
                assert one.bytes_per_scan <= two.bytes_per_scan


@pytest.mark.parametrize("encoding", encoding_names())
def test_what_is_sent_has_the_size_of_packed_signatures(encoding) -> None:
    parameters = images_of(encoding).parameters
    basis = Localizer(build_map(drive(), replace(parameters, ranks=(2, 4)), segments=2)).basis
    narrow = Condition(disturb="fov:90").apply(drive().scan(0), np.random.default_rng(0))
    scan = narrow if encoding == "harmonic" else drive().scan(0)
    packed = len(pack_signatures(basis.encode(basis.image(scan))))
    points = swept(encoding).points
    found = [p for p in points if p.ranks == (2, 4) and p.segments == 2]
    assert {p.sent_bytes for p in found} == {packed}


def test_ranks_that_images_do_not_have_are_left_out() -> None:
    of = images_of("harmonic")
    found = sweep(of, criterion(), SweepGrid((2, 20, 21), (2, 500), (10,)))
    assert [p.ranks for p in found.points] == [(2, 2), (20, 2)]
    with pytest.raises(InvalidParameters, match=r"^r1 is \[21, 30\], wanted one of at most 20"):
        sweep(of, criterion(), SweepGrid((21, 30), (2,), (10,)))
    with pytest.raises(InvalidParameters, match=r"^r2 is \[182\], wanted one of at most 181"):
        sweep(of, criterion(), SweepGrid((2,), (182,), (10,)))


@given(
    st.integers(1, 5), st.integers(1, 6), st.data()
)  # fmt: skip
def test_leading_sums_are_sums_over_leading_blocks(rows, columns, data) -> None:
    blocks = np.random.default_rng(rows * columns).random((3, rows, columns))
    r1 = sorted(data.draw(st.sets(st.integers(1, rows), min_size=1)))
    r2 = sorted(data.draw(st.sets(st.integers(1, columns), min_size=1)))
    sums = leading_sums(blocks, r1, r2)
    for a, first in enumerate(r1):
        for b, second in enumerate(r2):
            np.testing.assert_allclose(
                sums[:, a, b], blocks[:, :first, :second].sum(axis=(1, 2)), rtol=1e-12
            )


def test_the_same_scans_are_held_out_with_any_segments_and_few_are_spread_evenly() -> None:
    held_out, queried = held_out_scans(drive(), Every(2), 4)
    assert held_out.sum() == 20
    assert queried.tolist() == [1, 13, 27, 39]
    with pytest.raises(InvalidParameters, match="some must be queried"):
        held_out_scans(drive(1), Every(2), 4)


def test_without_poses_an_answer_is_right_near_the_query() -> None:
    unknown = MemoryDrive("d", [Scan(scan.points_m) for scan in recording(scans=40).scans])
    by_index = criterion(unknown, tolerance_scans=2)
    assert "2 scans" in str(by_index)
    assert by_index.right(np.array([5, 5]), np.array([7, 8])).tolist() == [True, False]
    found = sweep(images_of("paper", unknown), by_index, GRID)
    assert found.counted == found.queries == 8
    assert all(0.0 <= p.mean_accuracy <= 1.0 for p in found.points)


def test_scans_that_cannot_be_queried_are_reported_and_not_counted() -> None:
    scans = list(recording(scans=40).scans)
    scans[2] = Scan(np.array([[0.0, 0.0, 50.0]] * 5), pose=scans[2].pose)  # straight up
    of = images_of("paper", MemoryDrive("d", scans))
    assert of.refused == (2,)
    assert len(of.queries) == 7


def test_a_segment_without_a_map_scan_is_rejected() -> None:
    with pytest.raises(InvalidParameters, match="segment 1 is left"):
        sweep(images_of("paper", split=Every(2)), criterion(), SweepGrid((2,), (2,), (1,)))


@pytest.mark.parametrize("wrong", [(), (0,), (-1, 3)])
def test_a_grid_without_whole_numbers_above_0_is_rejected(wrong) -> None:
    with pytest.raises(InvalidParameters, match="r2"):
        SweepGrid((2,), wrong, (10,))
