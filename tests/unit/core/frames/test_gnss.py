import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import AnchorDoesNotFit, InvalidParameters
from core.frames.gnss import GnssTrack, fit_anchor
from core.mapping.anchor import Anchor
from core.simulation import SimulatedDrive

DRIVE = SimulatedDrive(seed=3, scans=240)
TIMES_S, PLACES_M = DRIVE.timestamp_s, DRIVE.poses[:, :3]
TRUE = Anchor(49.01, 8.4, 115.0, 30.0, 20.0, -10.0, 1.0)


def track(anchor=TRUE, *, noise_m=1.0, outliers=0.2, every=2, seed=1, altitude=True):
    """A receiver's fixes of the drive: between scans, noisy, and some beside the street."""
    rng = np.random.default_rng(seed)
    times_s = TIMES_S[:-1:every] + 0.04
    points_m = np.stack([np.interp(times_s, TIMES_S, axis_m) for axis_m in PLACES_M.T], axis=1)
    points_m += rng.normal(scale=noise_m, size=points_m.shape)
    wrong = rng.random(len(points_m)) < outliers
    points_m[wrong, :2] += rng.normal(scale=80.0, size=(int(wrong.sum()), 2))
    places = anchor.wgs84(points_m)
    if not altitude:
        places[:, 2] = np.nan
    return GnssTrack(times_s, places, np.full(len(times_s), noise_m))


def fitted(track, places_m=PLACES_M, times_s=TIMES_S):
    return fit_anchor("monday", times_s, places_m, track)


@settings(max_examples=8)
@given(
    latitude_deg=st.floats(-75.0, 75.0),
    longitude_deg=st.floats(-180.0, 180.0),
    heading_deg=st.floats(-180.0, 180.0),
)
def test_an_anchor_is_found_again_among_noise_and_outliers(
    latitude_deg, longitude_deg, heading_deg
):
    true = Anchor(latitude_deg, longitude_deg, 115.0, heading_deg)
    found = fitted(track(true))
    ends_m = PLACES_M[[0, 120, 239]]
    apart_m = true.level_m(found.wgs84(ends_m)) - true.level_m(true.wgs84(ends_m))
    assert np.linalg.norm(apart_m[:, :2], axis=1).max() < 1.0
    assert abs(apart_m[:, 2]).max() < 1.0
    fit = found.fitted
    assert fit.drive == "monday"
    assert 0.6 * fit.fixes < fit.agreeing < fit.fixes
    assert fit.spread_m == pytest.approx(1.0, abs=0.3)
    assert fit.error_deg < 1.0


def test_a_path_across_180_degrees_of_longitude_has_its_anchor_there():
    ahead_m = np.linspace(-450.0, 450.0, 100)
    places_m = np.stack([ahead_m, 30.0 * np.sin(ahead_m / 200.0), 0.0 * ahead_m], axis=1)
    times_s, true = np.arange(100.0), Anchor(-16.8, 180.0, 100.0)
    track = GnssTrack(times_s, true.wgs84(places_m), np.full(100, np.nan))
    assert np.count_nonzero(track.places[:, 1] > 0.0) == 50
    found = fit_anchor("monday", times_s, places_m, track)
    assert found.heading_deg == pytest.approx(0.0, abs=0.1)
    assert abs(found.longitude_deg) == pytest.approx(180.0, abs=0.01)


def test_the_heading_of_an_anchor_is_from_east_at_its_point_and_not_in_the_middle_of_most_fixes():
    # Rounds in a town and then a road out of it: the mean of the fixes is far from their median.
    round_m, road_m = 300.0, 8000.0
    turn = np.linspace(0.0, 6.0 * np.pi, 400)
    town_m = round_m * np.stack([np.sin(turn), 1.0 - np.cos(turn), 0.0 * turn], axis=1)
    road = np.linspace(0.0, road_m, 400)[:, None] * [1.0, 0.0, 0.0]
    places_m, true = np.concatenate([town_m, road]), Anchor(60.2, 24.9, 20.0, 30.0)
    times_s = np.arange(800.0)
    track = GnssTrack(times_s, true.wgs84(places_m), np.full(800, np.nan))
    off_m = true.level_m(fitted(track, places_m, times_s).wgs84(places_m)) - true.level_m(
        track.places
    )
    assert np.linalg.norm(off_m[:, :2], axis=1).max() < 0.01


def test_a_drive_whose_times_do_not_rise_is_where_its_times_say():
    backwards = fit_anchor("monday", TIMES_S[::-1], PLACES_M[::-1], track())
    assert backwards == fitted(track())


def test_a_stop_counts_once_although_its_poses_jitter():
    rng = np.random.default_rng(4)
    driven_m, standing = np.arange(0.0, 200.0), 2000
    along_m = np.concatenate([driven_m[:100], np.full(standing, 100.0), driven_m[100:]])
    stands = along_m == 100.0
    places_m = np.stack([np.minimum(along_m, 120.0), np.maximum(along_m - 120.0, 0.0)], axis=1)
    places_m = np.column_stack([places_m, np.zeros(len(along_m))])
    times_s = np.linspace(0.0, 220.0, len(along_m))
    # In the shadow of a house all fixes of a stop are wrong by the same.
    seen_m = places_m + rng.normal(scale=0.3, size=places_m.shape)
    seen_m[stands] = places_m[stands] + [2.0, 2.0, 0.0]
    track = GnssTrack(times_s, TRUE.wgs84(seen_m), np.full(len(times_s), 1.0))
    jitter_m = rng.normal(scale=0.03, size=places_m.shape) * stands[:, None]
    found = fitted(track, places_m + jitter_m, times_s)
    middle_m = np.array([[100.0, 20.0, 0.0]])
    off_m = TRUE.level_m(found.wgs84(middle_m)) - TRUE.level_m(TRUE.wgs84(middle_m))
    assert np.linalg.norm(off_m[:, :2]) < 0.3
    assert 95 <= found.fitted.fixes <= 105


def test_without_altitudes_the_anchor_has_none():
    found = fitted(track(altitude=False))
    assert found.altitude_m == 0.0
    assert found.fitted.altitudes == 0


@pytest.mark.parametrize("without", [slice(3, 4), slice(None, None, 2), slice(20, None)])
def test_fixes_without_an_altitude_leave_that_of_the_others(without):
    whole, some = track(noise_m=0.1), track(noise_m=0.1)
    places = some.places.copy()
    places[without, 2] = np.nan
    some = GnssTrack(some.time_s, places, some.accuracy_m)
    of_all, of_some = fitted(whole), fitted(some)
    ends_m = PLACES_M[[0, 120, 239]]
    assert of_some.wgs84(ends_m)[:, 2] == pytest.approx(TRUE.wgs84(ends_m)[:, 2], abs=0.5)
    assert TRUE.level_m(of_some.wgs84(ends_m))[:, :2] == pytest.approx(
        TRUE.level_m(of_all.wgs84(ends_m))[:, :2], abs=0.01
    )
    assert of_all.fitted.altitudes == of_all.fitted.agreeing
    assert 0 < of_some.fitted.altitudes < of_some.fitted.agreeing


def test_a_track_without_a_fix_is_rejected():
    with pytest.raises(InvalidParameters, match="the track has no fix, wanted at least 8"):
        fitted(GnssTrack(np.zeros(0), np.zeros((0, 3)), np.zeros(0)))


def test_places_are_metres_of_an_anchor_and_back():
    points_m = np.array([[10.0, 20.0, 3.0], [-5000.0, 700.0, 90.0]])
    level = Anchor(TRUE.latitude_deg, TRUE.longitude_deg, TRUE.altitude_m)
    assert level.level_m(level.wgs84(points_m)) == pytest.approx(points_m, abs=1e-6)


@pytest.mark.parametrize(
    ("made", "wanted"),
    [
        (lambda: (track(), PLACES_M / 0.3048), "its poses in metres"),
        (lambda: (track(), np.roll(PLACES_M, 60, axis=0)), "fixes are within 5 m of drive monday"),
        (lambda: (track(outliers=0.8), PLACES_M), "fixes are within 5 m of drive monday"),
        (lambda: (cut(track(), 12), PLACES_M), "give a longer track|is the track too short"),
        (lambda: (cut(track(), 40, by=3600.0), PLACES_M), "are both by one clock"),
        (lambda: (in_milliseconds(track()), PLACES_M), "1 of 120 fixes are .* its clock another"),
        (lambda: (track(), np.full_like(PLACES_M, np.nan)), "has 0 scans with a pose and a time"),
    ],
)
def test_a_track_that_does_not_fit_is_refused_with_the_figures(made, wanted):
    fixes, places_m = made()
    with pytest.raises(AnchorDoesNotFit, match=wanted):
        fitted(fixes, places_m)


def in_milliseconds(of):
    since_s = of.time_s - of.time_s[0]
    return GnssTrack(of.time_s[0] + 1000.0 * since_s, of.places, of.accuracy_m)


def cut(of, count, by=0.0):
    return GnssTrack(of.time_s[:count] + by, of.places[:count], of.accuracy_m[:count])
