"""The laws of segments that grow while one model explains the scans."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.arrays import Float32Array, FloatArray
from core.encodings.blocks import BLOCK_SCANS
from core.encodings.distance import Distance
from core.errors import InvalidParameters
from core.parameters import MapParameters, Segmentation
from core.projection.images import MemoryImages
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.sensor import AngularGrid
from core.segmentation.turns import turns
from core.segmentation.unequal import cut_unequal, length_limits
from tests.support.samples import RecordedProgress, straight_poses, trajectory

pytestmark = pytest.mark.slow

GRID = AngularGrid(elevation_min_deg=-30.0, elevation_step_deg=10.0, rows=6, azimuth_step_deg=20.0)
RINGS = RingGrid(ring_m=10.0, rings=6, azimuth_step_deg=20.0)
PAPER = MapParameters(ranks=(2, 2), grid=GRID, segmentation=Segmentation.UNEQUAL)
HARMONIC = MapParameters(
    "harmonic", (2, 2), Reducer.MEAN, "hdl-64e", RINGS, 1.73, Distance.NORMALISED,
    (-2.0, 0.5), Segmentation.UNEQUAL,
)  # fmt: skip


class StreamedImages(MemoryImages):
    """Images in memory that write down which of them are read."""

    def __init__(self, cells: Float32Array, grid: AngularGrid | RingGrid) -> None:
        super().__init__(cells, grid)
        self.reads: list[tuple[int, int]] = []

    def read(self, start: int, stop: int) -> Float32Array:
        self.reads.append((start, stop))
        return super().read(start, stop)


def surroundings(scans: int, changes: list[int], seed: int, shape: tuple[int, ...]) -> Float32Array:
    """Return images of places that change at some scans, with little noise between."""
    rng = np.random.default_rng(seed)
    images = np.empty((scans, *shape), np.float32)
    for start, end in zip([0, *changes], [*changes, scans], strict=True):
        row, column = rng.uniform(0, 1, shape[-2]) ** 8, rng.uniform(0, 1, shape[-1]) ** 8
        place = 50.0 * np.outer(row, column) + rng.uniform(0.0, 0.5, shape)
        images[start:end] = place + rng.uniform(0.0, 0.5, (end - start, *shape))
    return images


@settings(max_examples=40)
@given(
    st.lists(st.integers(1, 120), min_size=1, max_size=3),
    st.integers(1, 70),
    st.integers(0, 10**6),
    st.booleans(),
    st.data(),
)
def test_segments_cover_all_scans_within_their_limits_and_never_share_a_drive(
    lengths, segment_length, seed, harmonic, data
):
    scans = sum(lengths)
    changes = sorted(data.draw(st.sets(st.integers(1, max(1, scans - 1)), max_size=4)) - {scans})
    parameters = HARMONIC if harmonic else PAPER
    images = surroundings(scans, changes, seed, parameters.imager.shape)
    poses = np.full((scans, 7), np.nan) if data.draw(st.booleans()) else straight_poses(scans)
    starts = np.cumsum([0, *lengths])
    mapped = trajectory(*[poses[a:b] for a, b in itertools.pairwise(starts)])
    source = StreamedImages(images, parameters.grid)
    cuts = cut_unequal(source, mapped, segment_length, parameters)
    assert set(starts.tolist()) <= set(cuts.tolist())
    shortest, longest = length_limits(segment_length)
    sizes = np.diff(cuts)
    assert (sizes >= 1).all()
    assert (sizes <= longest).all()
    of_short_drive = np.isin(cuts[:-1], starts[:-1]) & np.isin(cuts[1:], starts)
    assert (sizes[~of_short_drive] >= shortest).all()
    again = cut_unequal(MemoryImages(images, parameters.grid), mapped, segment_length, parameters)
    assert again.tolist() == cuts.tolist()
    assert all(stop - start <= BLOCK_SCANS for start, stop in source.reads)


@pytest.mark.parametrize("parameters", [PAPER, HARMONIC])
@pytest.mark.parametrize("change", [35, 50, 71])
def test_a_segment_ends_where_the_surroundings_change(parameters, change):
    images = surroundings(120, [change], 3, parameters.imager.shape)
    mapped = trajectory(straight_poses(120))
    cuts = cut_unequal(MemoryImages(images, parameters.grid), mapped, 60, parameters)
    assert len(cuts) == 3
    assert abs(cuts[1] - change) <= 7  # a block of 60 / 2 / 4 scans


@pytest.mark.parametrize("parameters", [PAPER, HARMONIC])
def test_one_place_is_one_segment_up_to_its_longest(parameters):
    images = surroundings(160, [], 4, parameters.imager.shape)
    source = MemoryImages(images, parameters.grid)
    assert cut_unequal(source, trajectory(straight_poses(160)), 80, parameters).tolist() == [0, 160]
    assert cut_unequal(source, trajectory(straight_poses(160)), 60, parameters).tolist() == [
        0, 120, 160
    ]  # fmt: skip


def corner(scans: int, at: int, step_m: float) -> FloatArray:
    poses = straight_poses(scans, step_m)
    poses[at:, 1] = step_m * np.arange(scans - at)
    poses[at:, 0] = poses[at, 0]
    return poses


def test_a_segment_ends_at_a_turn_if_poses_are_known():
    images = MemoryImages(surroundings(120, [], 5, (6, 19)), GRID)
    mapped = trajectory(corner(120, 47, 1.5))
    assert abs(turns(mapped) - 47).max() <= 2
    assert abs(cut_unequal(images, mapped, 60, PAPER) - [0, 47, 120]).max() <= 2
    # Without poses, one model explains both streets.
    unknown = trajectory(np.full((120, 7), np.nan))
    assert cut_unequal(images, unknown, 60, PAPER).tolist() == [0, 120]
    # Too near to the beginning for a segment of at least 30.
    early = trajectory(corner(120, 20, 1.5))
    assert cut_unequal(images, early, 60, PAPER).tolist() == [0, 120]


def test_a_bend_a_stationary_vehicle_and_yaw_without_a_bend_are_no_turns():
    angle = np.linspace(0.0, np.pi / 2, 150)
    bend = straight_poses(150)
    bend[:, 0], bend[:, 1] = 100.0 * np.sin(angle), 100.0 * (1.0 - np.cos(angle))
    assert not len(turns(trajectory(bend)))
    yawing = straight_poses(100)
    yawing[:, 5], yawing[:, 6] = np.sin(np.arange(100) / 9.0), np.cos(np.arange(100) / 9.0)
    assert not len(turns(trajectory(yawing)))
    stationary = np.repeat(straight_poses(1), 60, axis=0)
    stationary[:, :2] += np.random.default_rng(0).uniform(-0.3, 0.3, (60, 2))
    assert not len(turns(trajectory(stationary)))


@given(st.floats(60.0, 170.0), st.floats(-3.0, 3.0), st.sampled_from([0.5, 1.0, 2.5]))
def test_a_corner_is_one_turn_in_either_direction(degrees, heading, step_m):
    half = np.arange(0.0, 80.0, step_m)
    poses = np.zeros((2 * len(half), 7))
    poses[:, 6] = 1.0
    after = heading + np.radians(degrees)
    poses[: len(half), :2] = np.outer(half - 80.0, [np.cos(heading), np.sin(heading)])
    poses[len(half) :, :2] = np.outer(half, [np.cos(after), np.sin(after)])
    [row] = turns(trajectory(poses))
    assert np.linalg.norm(poses[row, :2]) <= 4.0 + step_m


def test_progress_receives_every_image_and_images_must_be_as_many_as_scans():
    progress = RecordedProgress()
    images = MemoryImages(surroundings(130, [40], 6, (6, 19)), GRID)
    mapped = trajectory(straight_poses(70), straight_poses(60))
    cut_unequal(images, mapped, 20, PAPER, progress)
    assert progress.stages == [("segmenting", 130)]
    assert progress.done == [130]
    with pytest.raises(InvalidParameters, match="130 images and 70 scans"):
        cut_unequal(images, trajectory(straight_poses(70)), 20, PAPER)
    with pytest.raises(InvalidParameters, match="segment_length is 0"):
        cut_unequal(images, mapped, 0, PAPER)


@pytest.mark.parametrize(
    ("parameters", "ranks"), [(PAPER, (6, 19)), (HARMONIC, (6, 2))], ids=["paper", "harmonic"]
)
def test_a_model_that_leaves_out_only_rounding_is_not_surprised(parameters, ranks):
    parameters = replace(parameters, ranks=ranks)
    images = surroundings(80, [13, 37], 5, parameters.imager.shape)
    cuts = cut_unequal(
        MemoryImages(images, parameters.grid), trajectory(straight_poses(80)), 40, parameters
    )
    assert cuts.tolist() == [0, 80]
