"""Rays against solids, where the answer is known by hand."""

import math

import numpy as np
import pytest

from core.arrays import Float32Array, FloatArray
from core.errors import InvalidParameters, InvalidPose, TooFewReturns
from core.scans.beams import HDL_64E_BEAMS_DEG
from core.scans.pose import Pose
from core.scans.sensor import SENSORS, sensor_named
from core.simulation.raycast import SimulatedSensor, cast
from core.simulation.world import Boxes, Cylinders, Scene

HEIGHT_M = 1.73
POSE = Pose(0.0, 0.0, HEIGHT_M)


def seen_ahead(scene: Scene, beam_deg: float, pose: Pose = POSE) -> FloatArray:
    """Return what one noiseless beam sees straight ahead: one point or none, `(0 or 1, 3)`."""
    sensor = SimulatedSensor(
        beams_deg=(beam_deg, -80.0),  # the second sees the ground in any case: no empty scan
        firings=3,  # the second of them looks straight ahead
        range_noise_m=0.0,
        dropout=0.0,
    )
    points = cast(scene, pose, sensor, np.random.default_rng(0)).points_m.astype(np.float64)
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    hit = (np.abs(points[:, 1]) < 1e-5) & (points[:, 0] > 0) & (np.abs(elevation - beam_deg) < 1e-3)
    return np.asarray(points[hit])


def assert_seen(point: FloatArray, x_m: float, z_m: float) -> None:
    np.testing.assert_allclose(point, np.array([[x_m, 0.0, z_m]]), atol=1e-5)


def box(near_m: float, far_m: float, top_m: float, bottom_m: float = 0.0) -> list[float]:
    return [(near_m + far_m) / 2, 0.0, 0.0, far_m - near_m, 6.0, bottom_m, top_m]


def test_a_wall_ahead_is_seen_at_its_distance():
    point = seen_ahead(Scene(Boxes([box(10.0, 12.0, 5.0)])), beam_deg=0.0)
    assert_seen(point, 10.0, 0.0)


def test_a_beam_that_falls_meets_the_wall_lower():
    point = seen_ahead(Scene(Boxes([box(10.0, 12.0, 5.0)])), beam_deg=-5.0)
    assert_seen(point, 10.0, -10.0 * math.tan(math.radians(5.0)))


def test_a_car_before_the_wall_hides_it():
    scene = Scene(Boxes([box(10.0, 12.0, 5.0), box(6.0, 8.0, 1.5)]))
    hidden, over = seen_ahead(scene, beam_deg=-5.0), seen_ahead(scene, beam_deg=0.0)
    assert hidden[0, 0] == pytest.approx(6.0, abs=1e-5)
    assert over[0, 0] == pytest.approx(10.0, abs=1e-5)


def test_the_order_of_solids_does_not_matter():
    scene = Scene(Boxes([box(6.0, 8.0, 1.5), box(10.0, 12.0, 5.0)]))
    point = seen_ahead(scene, beam_deg=-5.0)
    assert point[0, 0] == pytest.approx(6.0, abs=1e-5)


def test_the_ground_is_seen_at_height_over_tangent():
    point = seen_ahead(Scene(), beam_deg=-10.0)
    across_m = HEIGHT_M / math.tan(math.radians(10.0))
    assert_seen(point, across_m, -HEIGHT_M)


def test_the_ground_before_a_wall_hides_it():
    point = seen_ahead(Scene(Boxes([box(20.0, 22.0, 5.0)])), beam_deg=-10.0)
    assert point[0, 2] == pytest.approx(-HEIGHT_M, abs=1e-5)


def test_a_roof_is_seen_from_above():
    point = seen_ahead(Scene(Boxes([box(4.0, 9.0, 1.0)])), beam_deg=-8.0)
    across_m = (HEIGHT_M - 1.0) / math.tan(math.radians(8.0))
    assert 4.0 < across_m < 9.0
    assert_seen(point, across_m, 1.0 - HEIGHT_M)


def test_a_crown_is_seen_from_below_and_one_looks_under_it():
    crown = Cylinders([[10.0, 0.0, 3.0, 2.0, 6.0]])
    scene = Scene(Boxes([box(30.0, 31.0, 9.0)]), crown)
    below = seen_ahead(scene, beam_deg=2.0)
    across_m = (2.0 - HEIGHT_M) / math.tan(math.radians(2.0))
    assert 7.0 < across_m < 13.0
    assert_seen(below, across_m, 2.0 - HEIGHT_M)
    under = seen_ahead(scene, beam_deg=0.0)
    assert under[0, 0] == pytest.approx(30.0, abs=1e-5)


def test_a_pole_is_seen_at_its_near_side():
    point = seen_ahead(Scene(cylinders=Cylinders([[10.0, 0.0, 0.2, 0.0, 6.0]])), beam_deg=0.0)
    assert_seen(point, 9.8, 0.0)


def test_an_oblique_wall_is_seen_where_the_ray_meets_it():
    # A long wall through (10, 0) at 45 degrees, 2 m thick: its near face is 1 m sqrt(2) nearer.
    scene = Scene(Boxes([[10.0, 0.0, 45.0, 40.0, 2.0, 0.0, 5.0]]))
    point = seen_ahead(scene, beam_deg=0.0)
    assert point[0, 0] == pytest.approx(10.0 - math.sqrt(2.0), abs=1e-5)


def test_points_are_in_the_sensors_own_frame():
    scene = Scene(Boxes([[5.0, 17.0, 0.0, 6.0, 2.0, 0.0, 5.0]]))
    facing_y = Pose(5.0, 6.0, HEIGHT_M, 0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))
    point = seen_ahead(scene, beam_deg=0.0, pose=facing_y)  # at (5, 6), looking along +y
    assert_seen(point, 10.0, 0.0)


def test_every_return_agrees_with_a_slow_search_of_every_solid():
    rng = np.random.default_rng(3)
    near = rng.uniform(-40.0, 40.0, (40, 2))
    near = near[np.hypot(*near.T) > 8.0]
    sizes = rng.uniform([0.5, 0.5, 0.5], [12.0, 6.0, 9.0], (len(near), 3))
    rows = np.column_stack(
        [near, rng.uniform(-180, 180, len(near)), sizes[:, :2], np.zeros(len(near)), sizes[:, 2]]
    )
    rows[::5, 5] = rows[::5, 6] / 2.0  # some float, as crowns do
    sensor = SimulatedSensor(firings=16, range_noise_m=0.0, dropout=0.0)
    pose = Pose(0.5, -0.7, HEIGHT_M, 0.0, 0.0, math.sin(0.2), math.cos(0.2))
    scan = cast(Scene(Boxes(rows)), pose, sensor, rng)
    expected = slow_ranges(rows, pose, sensor)
    expected = expected[np.isfinite(expected)]
    got = np.linalg.norm(scan.points_m.astype(np.float64), axis=1)
    assert len(got) == len(expected)
    np.testing.assert_allclose(got, expected, rtol=1e-5)


def slow_ranges(rows: FloatArray, pose: Pose, sensor: SimulatedSensor) -> FloatArray:
    """March each ray against each box, three slabs at a time."""
    found = []
    for azimuth in np.radians(sensor.azimuths_deg + pose.yaw_deg):
        for beam in np.radians(sensor.beams_deg):
            ray = np.array(
                [
                    math.cos(beam) * math.cos(azimuth),
                    math.cos(beam) * math.sin(azimuth),
                    math.sin(beam) or 1e-15,
                ]
            )
            ground_m = -pose.z_m / ray[2] if ray[2] < 0 else math.inf
            best = ground_m if ground_m <= sensor.ground_range_m else math.inf
            for x, y, yaw_deg, length, width, bottom, top in rows:
                cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
                frame = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
                origin = frame @ [pose.x_m - x, pose.y_m - y, pose.z_m]
                local = frame @ ray
                low = np.array([-length / 2, -width / 2, bottom])
                high = np.array([length / 2, width / 2, top])
                one, other = (low - origin) / local, (high - origin) / local
                enter, leave = np.minimum(one, other).max(), np.maximum(one, other).min()
                if 0.0 < enter <= leave:
                    best = min(best, enter)
            found.append(best if best <= sensor.max_range_m else math.inf)
    return np.array(found)


def test_there_is_no_return_beyond_the_maximum_range():
    scene = Scene(Boxes([box(119.0, 121.0, 30.0)]))
    assert len(seen_ahead(scene, beam_deg=0.0)) == 1
    assert len(seen_ahead(Scene(Boxes([box(121.0, 123.0, 30.0)])), beam_deg=0.0)) == 0


def test_flat_ground_does_not_come_back_from_beyond_its_own_range():
    assert len(seen_ahead(Scene(), beam_deg=-2.0)) == 1  # 49.6 m
    assert len(seen_ahead(Scene(), beam_deg=-1.9)) == 0  # 52.2 m


def test_a_sensor_under_a_crown_does_not_see_it():
    crown = Cylinders([[0.0, 0.0, 3.0, 2.5, 6.0]])
    assert len(seen_ahead(Scene(cylinders=crown), beam_deg=0.0)) == 0


def test_returns_come_firing_by_firing_clockwise_from_behind():
    sensor = SimulatedSensor(beams_deg=(-10.0, -20.0), firings=8, range_noise_m=0.0, dropout=0.0)
    x, y, z = cast(Scene(), POSE, sensor, np.random.default_rng(0)).points_m.T.astype(np.float64)
    azimuth_deg = np.degrees(np.arctan2(y, x))
    np.testing.assert_allclose(azimuth_deg[::2], 157.5 - 45.0 * np.arange(8), atol=1e-4)
    np.testing.assert_allclose(azimuth_deg[::2], azimuth_deg[1::2], atol=1e-4)
    assert (np.hypot(x, y)[::2] > np.hypot(x, y)[1::2]).all()
    np.testing.assert_allclose(z, -HEIGHT_M, atol=1e-5)


def test_noise_is_along_the_ray_and_of_the_stated_size():
    sensor = SimulatedSensor(beams_deg=(-10.0,), firings=20_000, range_noise_m=0.05, dropout=0.0)
    points = cast(Scene(), POSE, sensor, np.random.default_rng(0)).points_m.astype(np.float64)
    range_m = np.linalg.norm(points, axis=1)
    assert range_m.mean() == pytest.approx(HEIGHT_M / math.sin(math.radians(10.0)), abs=2e-3)
    assert range_m.std() == pytest.approx(0.05, rel=0.05)
    np.testing.assert_allclose(points[:, 2] / range_m, -math.sin(math.radians(10.0)), atol=1e-6)


def test_dropouts_are_as_many_as_stated():
    sensor = SimulatedSensor(beams_deg=(-10.0,), firings=20_000, dropout=0.1)
    assert len(cast(Scene(), POSE, sensor, np.random.default_rng(0))) == pytest.approx(
        18_000, abs=200
    )


def test_the_beams_are_those_of_the_manual():
    beams = np.array(HDL_64E_BEAMS_DEG)
    assert len(beams) == 64
    assert beams[0] == 2.0
    assert beams[-1] == pytest.approx(-24.333, abs=1e-3)
    np.testing.assert_allclose(np.diff(beams[:32]), -1.0 / 3.0)
    np.testing.assert_allclose(np.diff(beams[31:]), -0.5)


def test_a_scan_without_a_return_is_rejected():
    sensor = SimulatedSensor(beams_deg=(1.0,), firings=4)
    with pytest.raises(TooFewReturns):
        cast(Scene(), POSE, sensor, np.random.default_rng(0))


@pytest.mark.parametrize(
    "pose", [Pose(0.0, 0.0, 1.0, 0.1, 0.0, 0.0, math.sqrt(0.99)), Pose(0.0, 0.0, 0.0)]
)
def test_a_tilted_or_buried_sensor_is_rejected(pose):
    with pytest.raises(InvalidPose, match="upright above the ground"):
        cast(Scene(), pose, SimulatedSensor(), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("beams_deg", ()),
        ("beams_deg", (90.0,)),
        ("firings", 0),
        ("range_noise_m", -0.1),
        ("max_range_m", 0.0),
        ("ground_range_m", math.nan),
        ("dropout", 1.0),
        ("fov_deg", 361.0),
    ],
)
def test_an_invalid_sensor_is_rejected_by_name(name, value):
    with pytest.raises(InvalidParameters, match=name):
        SimulatedSensor(**{name: value})


def angles_deg(points_m: Float32Array) -> tuple[FloatArray, FloatArray]:
    x, y, z = points_m.astype(np.float64).T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


@pytest.mark.parametrize("name", sorted(SENSORS))
def test_a_sensor_of_the_catalogue_has_its_rays_and_its_field_of_view(name):
    sensor = sensor_named(name)
    simulated = SimulatedSensor.of(sensor)
    walls = Scene(Boxes([[0.0, y, 0.0, 60.0, 1.0, 0.0, 90.0] for y in (-9.5, 9.5)]
                        + [[x, 0.0, 0.0, 1.0, 60.0, 0.0, 90.0] for x in (-9.5, 9.5)]))  # fmt: skip
    points = cast(walls, POSE, simulated, np.random.default_rng(0)).points_m
    assert len(points) == pytest.approx(0.97 * sensor.rays_per_scan, rel=0.02)
    azimuth, elevation = angles_deg(points)
    assert np.abs(azimuth).max() == pytest.approx(sensor.fov_deg / 2.0, abs=0.6)
    limits = sensor.beams_deg[[0, -1]]
    np.testing.assert_allclose([elevation.min(), elevation.max()], limits, atol=1.1)


def test_a_pattern_that_does_not_repeat_has_other_elevations_in_each_scan():
    wall = Scene(Boxes([[9.5, 0.0, 0.0, 1.0, 60.0, 0.0, 90.0]]))
    lines = []
    for name in ("avia", "hdl-64e"):
        scans = [
            cast(wall, POSE, SimulatedSensor.of(sensor_named(name)), np.random.default_rng(seed))
            for seed in (0, 1)
        ]
        first, second = (set(angles_deg(scan.points_m)[1].round(3).tolist()) for scan in scans)
        lines.append(len(first & second) / len(first))
    assert lines[0] < 0.1
    assert lines[1] > 0.9
