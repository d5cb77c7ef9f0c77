"""Priors narrow the search."""

from dataclasses import replace

import numpy as np
import pytest

from core.arrays import BoolArray
from core.confidence.decision import Refusal
from core.encodings.search import Neighbours
from core.errors import InvalidParameters, UnknownSegment
from core.localization.candidates import find_candidates
from core.localization.localizer import Localizer
from core.localization.priors import (
    HeadingPrior,
    MapPrior,
    OdometryPrior,
    PositionPrior,
    Priors,
    ScanOfMap,
    nearest_within,
)
from core.mapping.fit import fit_map
from core.projection.imager import Image
from core.projection.images import MemoryImages
from core.projection.rings import RingGrid
from core.scans.angles import wrapped_deg
from core.scans.trajectory import Trajectory
from tests.support.samples import (
    SMALL_GRID,
    calibrated_map,
    sample_harmonic_map,
    sample_image,
    sample_map,
    smooth_images,
    straight_poses,
    without_poses,
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


def rows_of(priors, tensor_map):
    return np.flatnonzero(MapPrior(priors, tensor_map).rows).tolist()


def test_a_position_is_a_gate_at_three_sigma_and_a_scans_reach(made):
    rows = rows_of(Priors(position=PositionPrior(50.0, 0.0, 2.0)), made)
    assert rows == list(range(39, 62))


@pytest.mark.parametrize("step_m", [3.0, 6.0, 12.0])
def test_a_sure_position_half_way_between_sparse_scans_allows_both(step_m):
    tensor_map, _ = sample_map()
    sparse = replace(tensor_map.trajectory, poses=straight_poses(len(tensor_map), step_m=step_m))
    prior = Priors(position=PositionPrior(4.5 * step_m, 2.5, 0.05))
    assert {4, 5} <= set(rows_of(prior, replace(tensor_map, trajectory=sparse)))


@pytest.mark.parametrize("far_m", [1e300, 1.7e308])
@pytest.mark.parametrize("sigma_m", [1.0, 5e-324])
def test_a_place_far_beyond_the_map_gives_no_warning(made, far_m, sigma_m):
    place = (far_m, -far_m)
    assert rows_of(Priors(position=PositionPrior(*place, sigma_m)), made) == []
    assert rows_of(Priors(odometry=OdometryPrior(place, 1.0, sigma_m)), made) == []


def test_odometry_allows_scans_within_the_distance_driven_from_a_place_or_a_scan(made):
    from_scan = Priors(odometry=OdometryPrior(ScanOfMap("smooth", 20), 10.0, 1.0))
    from_place = Priors(odometry=OdometryPrior((20.0, 0.0), 10.0, 1.0))
    assert rows_of(from_scan, made) == rows_of(from_place, made) == list(range(2, 39))


def test_segments_are_those_named(made):
    assert rows_of(Priors(segments=(1, 1)), made) == list(range(60, 120))


def test_priors_are_combined(made):
    priors = Priors(position=PositionPrior(58.0, 0.0, 1.0), segments=(1,))
    assert rows_of(priors, made) == list(range(60, 67))


def test_a_heading_prior_in_a_paper_map_allows_scans_recorded_in_that_heading(made):
    assert len(rows_of(Priors(heading=HeadingPrior(10.0, 2.0)), made)) == 120
    assert rows_of(Priors(heading=HeadingPrior(180.0, 10.0)), made) == []
    assert len(rows_of(Priors(heading=HeadingPrior(-355.0, 2.0)), made)) == 120


def test_a_right_prior_makes_the_match_more_probable(made, localizer, images):
    image = sample_image(made, images[51])
    plain = localizer.localize_image(image)
    with_prior = localizer.localize_image(
        image, priors=Priors(position=PositionPrior(52.0, 1.0, 3.0))
    )
    assert plain.best.row == with_prior.best.row == 51
    assert with_prior.localized
    assert with_prior.decision.probability >= plain.decision.probability


@pytest.mark.parametrize("sigma_m", [1e-6, 1.0, 100.0])
def test_a_right_prior_that_leaves_no_runner_up_makes_no_match_less_probable(made, images, sigma_m):
    # Most of what such a map knows is in the ratio to the runner-up.
    intercept, slope = made.calibration.alone
    lower = (intercept - 8.0, slope)
    unsure = replace(made.calibration, alone=lower, likelihood=lower)
    localizer = Localizer(replace(made, calibration=unsure))
    for row in range(3, 120, 9):
        x_m, y_m = made.trajectory.poses[row, :2].tolist()
        query = sample_image(made, images[row])
        priors = Priors(position=PositionPrior(x_m, y_m, sigma_m))
        without = localizer.localize_image(query)
        found = localizer.localize_image(query, priors=priors)
        assert without.localized
        assert found.localized
        assert (found.decision.probability or 0.0) >= (without.decision.probability or 1.0)


def test_a_stand_is_one_of_the_places_that_a_prior_leaves(made, images):
    # 60 of 120 scans of one stop: to leave it out leaves nearly as many places to be mistaken for.
    poses = straight_poses(120)
    poses[:60, 0] = 59.0
    stood = replace(made, trajectory=replace(made.trajectory, poses=poses))
    search = Localizer(stood).search_image(sample_image(stood, images[80]))
    driven = MapPrior(Priors(position=PositionPrior(95.0, 0.0, 8.0)), stood)
    assert driven.rows.sum() == 54
    assert find_candidates(stood, search, 1, driven).share == pytest.approx(54 / 61)
    at_stop = MapPrior(Priors(position=PositionPrior(59.0, 0.0, 0.1)), stood)
    assert at_stop.rows.sum() == 65
    assert find_candidates(stood, search, 1, at_stop).share == pytest.approx(6 / 61)


def test_a_wrong_prior_is_refused_as_outside_prior(made, localizer, images):
    image = sample_image(made, images[51])
    for priors in (
        Priors(position=PositionPrior(100.0, 0.0, 2.0)),
        Priors(position=PositionPrior(5000.0, 0.0, 2.0)),
        Priors(heading=HeadingPrior(180.0, 2.0)),
        Priors(odometry=OdometryPrior((100.0, 0.0), 5.0, 2.0)),
        Priors(segments=(1,)),
    ):
        found = localizer.localize_image(image, priors=priors)
        assert not found.localized
        assert found.decision.reason == Refusal.OUTSIDE_PRIOR


def test_a_heading_that_no_near_match_has_does_not_compare_the_whole_map(monkeypatch):
    monkeypatch.setattr("core.localization.priors._MOST", 40)
    tensor_map, images = sample_harmonic_map(count=200, segment_length=20)
    grid = tensor_map.parameters.grid
    assert isinstance(grid, RingGrid)
    search = Localizer(tensor_map).search_image(Image(images[7, 1], grid))
    compared: list[int] = []
    nearest = search.nearest

    def counted(k: int, among: BoolArray | None = None) -> Neighbours:
        compared.append(k)
        return nearest(k, among)

    monkeypatch.setattr(search, "nearest", counted)
    headings_deg = search.nearest(40).relative_yaw_deg
    free_deg = max(range(-180, 180), key=lambda deg: np.abs(wrapped_deg(headings_deg - deg)).min())
    heading = HeadingPrior(float(free_deg), 0.1)
    assert np.abs(wrapped_deg(headings_deg - free_deg)).min() > heading.gate_deg
    prior = MapPrior(Priors(heading=heading), tensor_map)
    assert len(nearest_within(search, 1, prior)) == 0
    assert max(compared) == 40


@pytest.mark.parametrize("heading", [None, HeadingPrior(0.0, 5.0)])
def test_another_prior_allows_scans_however_many_are_nearer_beyond_it(monkeypatch, heading):
    monkeypatch.setattr("core.localization.priors._MOST", 40)
    tensor_map, images = sample_harmonic_map(count=200, segment_length=20)
    grid = tensor_map.parameters.grid
    assert isinstance(grid, RingGrid)
    search = Localizer(tensor_map).search_image(Image(images[150, 1], grid))
    place = PositionPrior(50.0, 0.0, 0.01)
    rows = MapPrior(Priors(position=place), tensor_map).rows
    nearer = search.nearest(40).rows
    assert not rows[nearer].all()
    prior = MapPrior(Priors(position=place, heading=heading), tensor_map)
    all_there = search.nearest(200, rows)
    wanted = all_there[prior.allows(all_there)].rows.tolist()
    assert not set(wanted) <= set(nearer.tolist())
    assert nearest_within(search, 100, prior).rows.tolist() == wanted


def test_without_a_scan_within_the_priors_matches_are_of_the_whole_map(made, localizer, images):
    nowhere = Priors(position=PositionPrior(5000.0, 0.0, 2.0))
    found = localizer.localize_image(sample_image(made, images[51]), k=3, priors=nowhere)
    assert found.best.row == 51
    assert len(found.matches) == 3


def test_a_scan_without_a_pose_does_not_show_that_a_right_prior_is_wrong(made, images):
    localizer = Localizer(without_poses(made, *range(1, 120, 2)))
    image = sample_image(made, images[51])
    assert localizer.localize_image(image).best.row == 51  # its pose is not known
    right = Priors(position=PositionPrior(51.0, 0.0, 1.0))
    found = localizer.localize_image(image, priors=right)
    assert found.localized
    assert found.best.row in (50, 52)
    # Scans with a pose still show that a prior is wrong.
    wrong = Priors(position=PositionPrior(100.0, 0.0, 1.0))
    near = localizer.localize_image(sample_image(made, images[50]), priors=wrong)
    assert near.decision.reason == Refusal.OUTSIDE_PRIOR


def test_a_scan_without_a_pose_is_outside_of_a_segment(made, images):
    localizer = Localizer(without_poses(made, *range(1, 120, 2)))
    other = Priors(position=PositionPrior(70.0, 0.0, 5.0), segments=(1,))
    found = localizer.localize_image(sample_image(made, images[51]), priors=other)
    assert found.decision.reason == Refusal.OUTSIDE_PRIOR


def test_where_only_scans_without_a_pose_are_the_prior_leaves_out_none_of_them(made, images):
    localizer = Localizer(without_poses(made, *range(60)))
    image = sample_image(made, images[31])
    nowhere = Priors(position=PositionPrior(31.0, 0.0, 1.0))
    assert localizer.localize_image(image, priors=nowhere) == localizer.localize_image(image)
    posed = localizer.localize_image(sample_image(made, images[91]), priors=nowhere)
    assert posed.decision.reason == Refusal.OUTSIDE_PRIOR


def test_of_two_equal_places_the_one_nearer_to_the_prior_wins(made):
    """Two places look alike: the position decides, though the gate holds both."""
    _, images = sample_map(count=60, segment_length=30)
    twin = np.concatenate([images[:30], images[:30]])
    twins = _map_of(twin, made)
    assert twins.calibration is not None
    image = sample_image(twins, twin[10] + np.float32(0.01))
    localizer = Localizer(twins)
    for place_m in (10.0, 40.0):
        priors = Priors(position=PositionPrior(place_m, 0.0, 12.0))
        assert localizer.localize_image(image, priors=priors).best.row == int(place_m)


def _map_of(images, like):
    trajectory = Trajectory.of_drive("twins", np.arange(60.0), straight_poses(60), np.arange(60))
    source = MemoryImages(images, SMALL_GRID)
    built = fit_map(source, trajectory, np.array([0, 60]), like.parameters)
    return replace(built, calibration=like.calibration)


def test_a_heading_prior_in_a_harmonic_map_is_compared_with_the_matchs_heading():
    tensor_map, images = sample_harmonic_map(count=40, segment_length=20)
    localizer = Localizer(tensor_map)
    grid = tensor_map.parameters.grid
    assert isinstance(grid, RingGrid)
    query = Image(images[7, 1], grid)
    ahead = localizer.localize_image(query, priors=Priors(heading=HeadingPrior(3.0, 2.0)))
    assert ahead.best.row == 7
    back = localizer.localize_image(query, k=40, priors=Priors(heading=HeadingPrior(180.0, 2.0)))
    assert back.best.row != 7
    for match in back.matches:
        assert match.heading_deg is not None
        assert abs((match.heading_deg - 180.0 + 180.0) % 360.0 - 180.0) <= 11.0


def test_a_match_is_the_less_likely_the_farther_it_is_off_the_heading():
    tensor_map, _ = sample_harmonic_map(count=40, segment_length=20)
    prior = MapPrior(Priors(heading=HeadingPrior(10.0, 10.0)), tensor_map)
    yaw_deg = np.array([5.0, 10.0, 15.0, 25.0, 35.0])
    found = Neighbours(np.arange(5), np.ones(5), yaw_deg, np.zeros(5))
    np.testing.assert_allclose(prior.log_weight(found), [0.0, 0.0, 0.0, -0.5, -2.0], atol=1e-9)


@pytest.mark.parametrize(
    ("priors", "message"),
    [
        (Priors(position=PositionPrior(0.0, 0.0, 1.0)), "no poses"),
        (Priors(heading=HeadingPrior(0.0, 1.0)), "no poses"),
        (Priors(odometry=OdometryPrior((0.0, 0.0), 1.0, 1.0)), "no poses"),
    ],
)
def test_a_prior_of_place_needs_a_map_with_poses(priors, message):
    tensor_map, _ = sample_map(poses=False)
    with pytest.raises(InvalidParameters, match=message):
        MapPrior(priors, tensor_map)


def test_segments_need_no_poses():
    tensor_map, _ = sample_map(poses=False)
    assert rows_of(Priors(segments=(2,)), tensor_map) == list(range(16, 24))


@pytest.mark.parametrize("named", [ScanOfMap("smooth", 999), ScanOfMap("other", 1)])
def test_a_fix_that_the_map_does_not_have_is_rejected(made, named):
    with pytest.raises(InvalidParameters, match="no scan"):
        MapPrior(Priors(odometry=OdometryPrior(named, 1.0, 1.0)), made)


def test_a_segment_that_the_map_does_not_have_is_rejected(made):
    with pytest.raises(UnknownSegment):
        MapPrior(Priors(segments=(7,)), made)


@pytest.mark.parametrize(
    "make",
    [
        lambda: PositionPrior(np.nan, 0.0, 1.0),
        lambda: PositionPrior(0.0, 0.0, 0.0),
        lambda: PositionPrior(0.0, 0.0, np.inf),
        lambda: HeadingPrior(np.inf, 1.0),
        lambda: HeadingPrior(0.0, -1.0),
        lambda: OdometryPrior((0.0, 0.0), -1.0, 1.0),
        lambda: OdometryPrior((0.0, np.nan), 1.0, 1.0),
        lambda: OdometryPrior((0.0, 0.0), 1.0, 0.0),
        lambda: Priors(segments=()),
    ],
)
def test_an_impossible_prior_is_rejected(make):
    with pytest.raises(InvalidParameters):
        make()


@pytest.mark.parametrize("sample", [sample_map, sample_harmonic_map])
def test_a_heading_makes_no_wrong_match_rarer_because_streets_are_aligned(sample):
    mapped, _ = sample(count=40, segment_length=10)
    for sigma_deg in (1.0, 20.0):
        narrow = Priors(heading=HeadingPrior(90.0, sigma_deg))
        assert MapPrior(narrow, mapped).share == 1.0
    x_m, y_m = mapped.trajectory.poses[5, :2].tolist()
    place = PositionPrior(x_m, y_m, 3.0)
    by_place = MapPrior(Priors(position=place), mapped).share
    assert by_place < 1.0
    both = Priors(position=place, heading=HeadingPrior(90.0, 1.0))
    assert MapPrior(both, mapped).share == by_place
