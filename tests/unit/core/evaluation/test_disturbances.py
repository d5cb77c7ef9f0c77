"""Each disturbance does what its definition requires, and nothing else."""

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.evaluation.condition import Condition
from core.evaluation.disturbances import (
    DISTURBANCES,
    Recording,
    parse_disturbance,
    parse_disturbances,
)
from core.evaluation.query_set import QuerySet
from core.evaluation.selected import SelectedScans
from core.scans.drive import MemoryDrive
from core.scans.mounting import Mounting, vehicle_drive
from core.scans.scan import Scan
from core.scans.sensor import HDL_64E, sensor_named

HEIGHT_M = 1.73
HDL64 = Recording(HDL_64E, HEIGHT_M)


def disturbed(text, points_m, seed=0):
    return parse_disturbance(text).apply(points_m, HDL64, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def around():
    """Returns in all directions, 3 to 60 m away, on the beams of an HDL-64E."""
    rng = np.random.default_rng(0)
    azimuth = rng.uniform(-np.pi, np.pi, 20_000)
    elevation = np.radians(rng.choice(HDL_64E.beams_deg, 20_000))
    range_m = rng.uniform(3.0, 60.0, 20_000)
    across_m = range_m * np.cos(elevation)
    return np.stack(
        [across_m * np.cos(azimuth), across_m * np.sin(azimuth), range_m * np.sin(elevation)], 1
    )


def azimuth_deg(points_m):
    return np.degrees(np.arctan2(points_m[:, 1], points_m[:, 0]))


def ranges_m(points_m):
    return np.linalg.norm(points_m, axis=1)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_the_same_seed_disturbs_the_same_way_and_leaves_its_input_alone(around, name):
    value = {"truck": "2", "beams": "16", "fov": "120"}.get(name, "0.5")
    before = around.copy()
    once, again = (disturbed(f"{name}:{value}", around, seed=3) for _ in range(2))
    assert once.tobytes() == again.tobytes()
    assert around.tobytes() == before.tobytes()
    assert len(once) <= len(around)


def test_hidden_takes_one_sector_of_its_width_anywhere(around):
    centres = []
    for seed in range(20):
        left = np.sort(azimuth_deg(disturbed("hidden:60", around, seed)))
        gaps = np.diff(np.append(left, left[0] + 360.0))
        assert gaps.max() == pytest.approx(60.0, abs=0.5)
        assert np.sort(gaps)[-2] < 1.0
        centres.append((left[gaps.argmax()] + 30.0 + 180.0) % 360.0)
    assert np.ptp(centres) > 180.0


def test_fov_keeps_the_front(around):
    left = azimuth_deg(disturbed("fov:120", around))
    assert np.abs(left).max() <= 60.0
    assert len(left) == (np.abs(azimuth_deg(around)) <= 60.0).sum()


@pytest.mark.parametrize(("text", "sides"), [("truck:1", 1), ("truck:2", 2)])
def test_trucks_stop_the_rays_that_meet_them(around, text, sides):
    left = disturbed(text, around)
    moved = np.flatnonzero(ranges_m(left) < ranges_m(around) - 1e-9)
    hits = left[moved]
    assert len(np.unique(np.sign(hits[:, 1]))) == sides
    beside_m, up_m = np.abs(hits[:, 1]), hits[:, 2] + HEIGHT_M
    assert beside_m.min() >= 3.2 - 1.25 - 1e-9
    assert beside_m.max() <= 3.2 + 1.25 + 1e-9
    assert up_m.min() >= -1e-9
    assert up_m.max() <= 4.0 + 1e-9
    assert hits[:, 0].min() >= -8.0
    assert hits[:, 0].max() <= 8.0 + 1e-9
    # Each hit is on the ray of its return, and the others stay where they were.
    np.testing.assert_allclose(np.cross(hits, around[moved]), 0.0, atol=1e-9)
    others = np.delete(np.arange(len(around)), moved)
    assert (left[others] == around[others]).all()


def test_a_ray_straight_to_the_side_meets_a_truck_at_its_near_side():
    wall = np.array([[0.0, 20.0, 0.0], [0.0, -20.0, 0.0], [20.0, 0.0, 0.0], [0.0, 20.0, 30.0]])
    left = disturbed("truck:2", wall)
    expected = [[0.0, 1.95, 0.0], [0.0, -1.95, 0.0], [20.0, 0.0, 0.0], [0.0, 20.0, 30.0]]
    np.testing.assert_allclose(left, expected, atol=1e-12)


@pytest.mark.parametrize(("text", "axis"), [("pitch:3", 1), ("roll:5", 0)])
def test_a_tilt_rotates_about_its_axis_to_either_side(around, text, axis):
    degrees = float(text.partition(":")[2])
    signs = set()
    for seed in range(10):
        left = disturbed(text, around, seed)
        np.testing.assert_allclose(ranges_m(left), ranges_m(around))
        np.testing.assert_allclose(left[:, axis], around[:, axis])
        others = [i for i in range(3) if i != axis]
        rotated_deg = np.degrees(
            np.angle(
                (left[:, others] @ [1, 1j]) / (around[:, others] @ [1, 1j]),
            )
        )
        assert np.abs(np.abs(rotated_deg) - degrees).max() < 1e-6
        signs.add(np.sign(rotated_deg[0]))
    assert signs == {-1.0, 1.0}


def test_height_reach_and_drop(around):
    np.testing.assert_allclose(disturbed("height:0.5", around), around - [0, 0, 0.5])
    assert ranges_m(disturbed("reach:30", around)).max() <= 30.0
    assert len(disturbed("reach:30", around)) == (ranges_m(around) <= 30.0).sum()
    assert len(disturbed("drop:0.95", around)) == pytest.approx(1_000, abs=150)


def test_snow_brings_a_share_of_the_returns_nearer_on_their_rays(around):
    left = disturbed("snow:0.2", around)
    nearer = ranges_m(left) < ranges_m(around) - 1e-9
    assert 0.1 < nearer.mean() < 0.2  # some flakes are behind what is seen
    assert ranges_m(left[nearer]).min() > 0.5
    assert np.median(ranges_m(left[nearer])) == pytest.approx(4.6, abs=0.5)
    np.testing.assert_allclose(np.cross(left, around), 0.0, atol=1e-9)


def test_beams_keep_what_is_nearest_to_them(around):
    elevation = np.unique(
        np.degrees(np.arcsin((left := disturbed("beams:16", around))[:, 2] / ranges_m(left))).round(
            6
        )
    )
    assert 12 <= len(elevation) <= 20
    assert np.diff(elevation).max() < 3.0
    other = disturbed("beams:vlp-16", around)
    own = np.degrees(np.arcsin(other[:, 2] / ranges_m(other)))
    apart = np.abs(own[:, None] - sensor_named("vlp-16").beams_deg).min(axis=1)
    assert apart.max() <= 0.25


def test_beams_of_a_narrow_sensor_keep_what_it_would_have_had_in_its_field_of_view(around):
    left = disturbed("beams:avia", around)
    assert 34.0 < np.abs(azimuth_deg(left)).max() <= 35.2
    # Of 64 x 2083 rays around and all its beams inside 77.2 degrees; the Avia's 24,000 points are
    # spread over 70.4 x 77.2 degrees, of which the HDL-64E covers 26.3.
    in_view = (np.abs(azimuth_deg(around)) <= 35.2).sum()
    recorded = 64 * 2083 * 70.4 / 360.0
    assert len(left) == pytest.approx(in_view * 24_000 * (26.33 / 77.2) / recorded, rel=0.1)
    again, other = disturbed("beams:avia", around), disturbed("beams:avia", around, seed=1)
    assert left.tobytes() == again.tobytes()
    assert left.tobytes() != other.tobytes()  # the pattern does not repeat


def test_beams_of_a_sensor_that_looks_up_keep_what_both_see(around):
    left = disturbed("beams:mid-360", around)
    elevation = np.degrees(np.arcsin(left[:, 2] / ranges_m(left)))
    assert -7.001 < elevation.min() < -6.0
    assert np.abs(azimuth_deg(left)).max() > 175.0
    seen = np.degrees(np.arcsin(around[:, 2] / ranges_m(around))) >= -7.0
    # 20,000 points over 59 degrees, 9 of them shared; 28 of the 64 beams are above -7 degrees.
    share = 20_000 * (9.0 / 59.0) / (28 * 2083)
    assert len(left) == pytest.approx(seen.sum() * share, rel=0.2)


def test_a_denser_sensor_adds_nothing(around):
    hap = Recording(sensor_named("hap"), HEIGHT_M)
    at = parse_disturbance("beams:horizon")
    within = around[np.abs(np.degrees(np.arcsin(around[:, 2] / ranges_m(around)))) <= 12.5]
    front = within[np.abs(azimuth_deg(within)) <= 81.7 / 2]
    vlp_16 = Recording(sensor_named("vlp-16"), HEIGHT_M)
    assert len(at.apply(within, vlp_16, np.random.default_rng(0))) == len(front)
    fewer = at.apply(within, hap, np.random.default_rng(0))
    assert len(fewer) == pytest.approx(len(front) * 11.7 / 15.07, rel=0.05)


def test_skew_moves_returns_behind_by_half_a_scan_and_none_ahead():
    points = np.array([[20.0, 0.0, 0.0], [-20.0, 1e-9, 0.0], [-20.0, -1e-9, 0.0]])
    left = disturbed("skew:15", points)
    np.testing.assert_allclose(left[0], points[0], atol=1e-9)
    assert left[1, 0] == pytest.approx(-20.75, abs=0.02)  # seen at the end: the vehicle moved ahead
    assert left[2, 0] == pytest.approx(-19.25, abs=0.02)  # seen at the beginning
    assert np.degrees(np.arctan2(left[1, 1], -left[1, 0])) == pytest.approx(1.5, abs=0.01)


def test_combinations_are_read_from_left_to_right():
    combined = parse_disturbances("beams:vlp-16+hidden:60,fov:120,")
    assert [[str(one) for one in item] for item in combined] == [
        ["beams:vlp-16", "hidden:60"], ["fov:120"], [],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hidden", "wanted NAME:VALUE"),
        ("fog:3", "there is no disturbance 'fog'; known are hidden, fov"),
        ("hidden:400", "hidden:400 is out of range, wanted 0 to 360 degrees"),
        ("truck:3", "wanted 1 or 2"),
        ("truck:1.5", "wanted 1 or 2"),
        ("hidden:wide", "has no number"),
        ("drop:nan", "out of range"),
        ("beams:vlp-17", "there is no sensor 'vlp-17'"),
    ],
)
def test_an_invalid_disturbance_is_rejected_by_name(text, message):
    with pytest.raises(InvalidParameters, match=message):
        parse_disturbance(text)


MOUNTINGS = [
    Mounting(1.2, -0.5, 2.3),
    Mounting(0.0, 0.0, HEIGHT_M, pitch_deg=15.0),
    Mounting(-1.0, 0.4, 1.1, roll_deg=178.0, pitch_deg=3.0, yaw_deg=70.0),
]


@pytest.mark.parametrize("mounting", MOUNTINGS, ids=str)
@pytest.mark.parametrize("text", ["beams:16", "beams:vlp-16", "reach:20"])
def test_what_a_mounted_sensor_lacks_is_what_it_lacks_on_any_vehicle(around, mounting, text):
    """`beams:16` of a sensor that looks down by 15 degrees kept two thirds of its returns."""
    recorded = Scan.from_returns(around)
    wanted = mounting.mount(Scan.from_returns(disturbed(text, around)), HEIGHT_M).points_m
    drive = vehicle_drive(MemoryDrive("monday", [recorded]), mounting, HEIGHT_M)
    seen: list[Scan] = []
    for of in (drive, SelectedScans(drive, np.array([0]))):
        queries = QuerySet(of, np.array([0]), (Condition(disturb=text),), 0, recording=HDL64)
        queries.answers([lambda _, scan: seen.append(scan)], "disturbing")
    assert [len(scan) for scan in seen] == [len(wanted)] * 2
    np.testing.assert_allclose(seen[0].points_m, wanted, atol=1e-4)


@pytest.mark.parametrize("mounting", MOUNTINGS, ids=str)
@pytest.mark.parametrize("text", ["beams:16", "reach:20"])
def test_the_beams_are_those_of_the_recording_in_whichever_direction_the_query_heads(
    around, mounting, text
):
    recording = Recording(HDL_64E, HEIGHT_M, mounting)
    mounted = mounting.mount(Scan.from_returns(around), HEIGHT_M)
    rng = np.random.default_rng(0)
    ahead = Condition(disturb=text).apply(mounted, rng, recording)
    wanted = Condition(yaw_deg=100.0).apply(ahead, rng)
    turned = Condition(yaw_deg=100.0, disturb=text).apply(mounted, rng, recording)
    assert len(turned) == len(wanted)
    np.testing.assert_allclose(turned.points_m, wanted.points_m, atol=1e-4)


@pytest.mark.parametrize("heading_deg", [0.0, 130.0])
@pytest.mark.parametrize("roll_deg", [0.0, 180.0])
def test_a_narrow_view_of_a_mounted_sensor_is_around_the_front_of_its_vehicle(
    around, roll_deg, heading_deg
):
    mounting = Mounting(0.0, 0.0, HEIGHT_M, roll_deg=roll_deg, yaw_deg=90.0)
    recording = Recording(HDL_64E, HEIGHT_M, mounting)
    rng = np.random.default_rng(0)
    heading = Condition(yaw_deg=heading_deg, disturb="fov:120")
    kept = heading.apply(Scan.from_returns(around), rng, recording).points_m
    assert len(kept) > 0.3 * len(around)
    assert np.abs(azimuth_deg(kept)).max() <= 60.0 + 1e-3


def test_a_truck_beside_a_mounted_sensor_is_beside_its_vehicle(around):
    mounted = Recording(HDL_64E, HEIGHT_M, MOUNTINGS[0])
    there = parse_disturbance("truck:2").apply(around, mounted, np.random.default_rng(0))
    np.testing.assert_array_equal(there, disturbed("truck:2", around))
