"""What is known beforehand narrows the search."""

from dataclasses import replace

import numpy as np
import pytest

from core.confidence.verdict import Refusal
from core.errors import InvalidParameters, UnknownSegment
from core.localization.localizer import Localizer
from core.localization.priors import (
    HeadingHint,
    Hints,
    OdometryHint,
    PositionHint,
    Prior,
    ScanOfMap,
)
from core.mapping.build import fit_map
from core.projection.imager import Image
from core.projection.images import MemoryImages
from core.projection.rings import RingGrid
from core.scans.trajectory import Trajectory
from tests.support.samples import (
    SMALL_GRID,
    calibrated_map,
    sample_harmonic_map,
    sample_image,
    sample_map,
    smooth_images,
    straight_poses,
)


@pytest.fixture(scope="module")
def made():
    return calibrated_map()


@pytest.fixture(scope="module")
def localizer(made):
    return Localizer(made)


@pytest.fixture(scope="module")
def images():
    return smooth_images(120, SMALL_GRID.shape)


def rows_of(hints, tensor_map):
    return np.flatnonzero(Prior(hints, tensor_map).rows).tolist()


def test_a_position_is_a_gate_at_three_sigma_and_a_scans_reach(made):
    rows = rows_of(Hints(position=PositionHint(50.0, 0.0, 2.0)), made)
    assert rows == list(range(39, 62))


def test_a_place_beyond_all_worlds_is_no_warning(made):
    far = (1e300, -1e300)
    assert rows_of(Hints(position=PositionHint(*far, 2.0)), made) == []
    assert rows_of(Hints(odometry=OdometryHint(far, 10.0, 1.0)), made) == []


def test_odometry_reaches_as_far_as_was_driven_from_a_place_or_a_scan(made):
    from_scan = Hints(odometry=OdometryHint(ScanOfMap("smooth", 20), 10.0, 1.0))
    from_place = Hints(odometry=OdometryHint((20.0, 0.0), 10.0, 1.0))
    assert rows_of(from_scan, made) == rows_of(from_place, made) == list(range(2, 39))


def test_segments_are_those_named(made):
    assert rows_of(Hints(segments=(1, 1)), made) == list(range(60, 120))


def test_hints_narrow_each_other(made):
    hints = Hints(position=PositionHint(58.0, 0.0, 1.0), segments=(1,))
    assert rows_of(hints, made) == list(range(60, 67))


def test_a_paper_map_answers_a_heading_by_the_scans_that_were_recorded_in_it(made):
    assert len(rows_of(Hints(heading=HeadingHint(10.0, 2.0)), made)) == 120
    assert rows_of(Hints(heading=HeadingHint(180.0, 10.0)), made) == []
    assert len(rows_of(Hints(heading=HeadingHint(-355.0, 2.0)), made)) == 120


def test_a_right_hint_makes_the_answer_more_probable(made, localizer, images):
    image = sample_image(made, images[51])
    plain = localizer.localize_image(image)
    hinted = localizer.localize_image(image, hints=Hints(position=PositionHint(52.0, 1.0, 3.0)))
    assert plain.best.row == hinted.best.row == 51
    assert hinted.localized
    assert hinted.verdict.probability >= plain.verdict.probability


def test_a_hint_of_elsewhere_is_told_and_not_believed(made, localizer, images):
    image = sample_image(made, images[51])
    for hints in (
        Hints(position=PositionHint(100.0, 0.0, 2.0)),
        Hints(position=PositionHint(5000.0, 0.0, 2.0)),
        Hints(heading=HeadingHint(180.0, 2.0)),
        Hints(odometry=OdometryHint((100.0, 0.0), 5.0, 2.0)),
        Hints(segments=(1,)),
    ):
        found = localizer.localize_image(image, hints=hints)
        assert not found.localized
        assert found.verdict.reason == Refusal.OUTSIDE_PRIOR


def test_what_no_hint_allows_is_shown_from_the_whole_map(made, localizer, images):
    nowhere = Hints(position=PositionHint(5000.0, 0.0, 2.0))
    found = localizer.localize_image(sample_image(made, images[51]), k=3, hints=nowhere)
    assert found.best.row == 51
    assert len(found.matches) == 3


def test_a_twin_nearer_to_the_hint_wins(made):
    """Two places look alike: the position decides, though the gate holds both."""
    _, images = sample_map(count=60, segment_length=30)
    twin = np.concatenate([images[:30], images[:30]])
    twins = _map_of(twin, made)
    assert twins.calibration is not None
    image = sample_image(twins, twin[10] + np.float32(0.01))
    localizer = Localizer(twins)
    for place_m in (10.0, 40.0):
        hints = Hints(position=PositionHint(place_m, 0.0, 12.0))
        assert localizer.localize_image(image, hints=hints).best.row == int(place_m)


def _map_of(images, like):
    trajectory = Trajectory.of_drive("twins", np.arange(60.0), straight_poses(60), np.arange(60))
    source = MemoryImages(images, SMALL_GRID)
    built = fit_map(source, trajectory, np.array([0, 60]), like.parameters)
    return replace(built, calibration=like.calibration)


def test_a_harmonic_map_is_held_to_the_heading_of_the_answer():
    tensor_map, images = sample_harmonic_map(count=40, segment_length=20)
    localizer = Localizer(tensor_map)
    grid = tensor_map.parameters.grid
    assert isinstance(grid, RingGrid)
    query = Image(images[7, 1], grid)
    ahead = localizer.localize_image(query, hints=Hints(heading=HeadingHint(3.0, 2.0)))
    assert ahead.best.row == 7
    back = localizer.localize_image(query, k=40, hints=Hints(heading=HeadingHint(180.0, 2.0)))
    assert back.best.row != 7
    for match in back.matches:
        assert match.heading_deg is not None
        assert abs((match.heading_deg - 180.0 + 180.0) % 360.0 - 180.0) <= 11.0


@pytest.mark.parametrize(
    ("hints", "said"),
    [
        (Hints(position=PositionHint(0.0, 0.0, 1.0)), "no poses"),
        (Hints(heading=HeadingHint(0.0, 1.0)), "no poses"),
        (Hints(odometry=OdometryHint((0.0, 0.0), 1.0, 1.0)), "no poses"),
    ],
)
def test_a_hint_of_a_place_wants_a_map_with_poses(hints, said):
    tensor_map, _ = sample_map(poses=False)
    with pytest.raises(InvalidParameters, match=said):
        Prior(hints, tensor_map)


def test_segments_need_no_poses():
    tensor_map, _ = sample_map(poses=False)
    assert rows_of(Hints(segments=(2,)), tensor_map) == list(range(16, 24))


@pytest.mark.parametrize("named", [ScanOfMap("smooth", 999), ScanOfMap("other", 1)])
def test_a_fix_that_the_map_does_not_have_is_refused(made, named):
    with pytest.raises(InvalidParameters, match="no scan"):
        Prior(Hints(odometry=OdometryHint(named, 1.0, 1.0)), made)


def test_a_segment_that_the_map_does_not_have_is_refused(made):
    with pytest.raises(UnknownSegment):
        Prior(Hints(segments=(7,)), made)


@pytest.mark.parametrize(
    "make",
    [
        lambda: PositionHint(np.nan, 0.0, 1.0),
        lambda: PositionHint(0.0, 0.0, 0.0),
        lambda: PositionHint(0.0, 0.0, np.inf),
        lambda: HeadingHint(np.inf, 1.0),
        lambda: HeadingHint(0.0, -1.0),
        lambda: OdometryHint((0.0, 0.0), -1.0, 1.0),
        lambda: OdometryHint((0.0, np.nan), 1.0, 1.0),
        lambda: OdometryHint((0.0, 0.0), 1.0, 0.0),
        lambda: Hints(segments=()),
    ],
)
def test_a_hint_that_cannot_be_is_refused(make):
    with pytest.raises(InvalidParameters):
        make()
