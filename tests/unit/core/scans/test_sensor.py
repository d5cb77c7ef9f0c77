"""The catalogue of sensors: figures of datasheets, looked up beside the code."""

import numpy as np
import pytest

from core.errors import InvalidParameters
from core.scans.sensor import SENSORS, AngularGrid, Sensor, sensor_named


@pytest.mark.parametrize(
    ("name", "beams", "lowest_deg", "highest_deg", "finest_deg"),
    [
        ("vlp-16", 16, -15.0, 15.0, 2.0),
        ("hdl-32e", 32, -30.67, 10.67, 1.33),
        ("hdl-64e", 64, -24.33, 2.0, 0.33),
        ("vls-128", 128, -25.0, 15.0, 0.11),
        ("os0-32", 32, -45.0, 45.0, 2.90),
        ("os0-64", 64, -45.0, 45.0, 1.43),
        ("os0-128", 128, -45.0, 45.0, 0.71),
        ("os1-32", 32, -22.5, 22.5, 1.45),
        ("os1-64", 64, -22.5, 22.5, 0.71),
        ("os1-128", 128, -22.5, 22.5, 0.35),
        ("os2-32", 32, -11.25, 11.25, 0.73),
        ("os2-64", 64, -11.25, 11.25, 0.36),
        ("os2-128", 128, -11.25, 11.25, 0.18),
        ("pandar40", 40, -25.0, 15.0, 0.33),
        ("pandar64", 64, -24.90, 14.88, 0.16),
        ("pandar128", 128, -25.02, 14.44, 0.12),
        ("rs-16", 16, -15.0, 15.0, 2.0),
        ("rs-32", 32, -25.0, 15.0, 0.33),
        ("rs-128", 128, -25.0, 15.0, 0.10),
    ],
)
def test_beams_are_as_many_and_where_the_maker_publishes_them(
    name, beams, lowest_deg, highest_deg, finest_deg
):
    beams_deg = SENSORS[name].beams_deg
    assert len(beams_deg) == beams
    assert beams_deg[[0, -1]].round(2).tolist() == [lowest_deg, highest_deg]
    assert np.diff(beams_deg).min() == pytest.approx(finest_deg, abs=0.006)
    assert SENSORS[name].repeats
    assert SENSORS[name].fov_deg == 360.0


@pytest.mark.parametrize(
    ("name", "fov_deg", "lowest_deg", "highest_deg", "points_per_s"),
    [
        ("mid-360", 360.0, -7.0, 52.0, 200_000),
        ("horizon", 81.7, -12.55, 12.55, 240_000),
        ("avia", 70.4, -38.6, 38.6, 240_000),
        ("hap", 120.0, -12.5, 12.5, 452_000),
    ],
)
def test_a_livox_has_a_field_of_view_and_a_point_rate(
    name, fov_deg, lowest_deg, highest_deg, points_per_s
):
    sensor = SENSORS[name]
    assert not sensor.repeats
    assert (sensor.fov_deg, 10 * sensor.rays_per_scan) == (fov_deg, points_per_s)
    assert sensor.beams_deg[[0, -1]].tolist() == [lowest_deg, highest_deg]
    # Lines and azimuths are as far apart, and are as many as the rays.
    assert np.diff(sensor.beams_deg)[0] == pytest.approx(360.0 / sensor.azimuths, rel=0.02)
    in_view = len(sensor.beams_deg) * sensor.azimuths * fov_deg / 360.0
    assert in_view == pytest.approx(sensor.rays_per_scan, rel=0.01)


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=lambda sensor: sensor.name)
def test_every_sensor_names_its_source_and_its_grid_has_all_its_beams(sensor):
    assert sensor.source
    rows = np.rint(
        (sensor.beams_deg - sensor.grid.elevation_min_deg) / sensor.grid.elevation_step_deg
    )
    assert (rows >= 0).all()
    assert (rows < sensor.grid.rows + (sensor.name == "hdl-64e")).all()
    assert (np.diff(sensor.beams_deg) > 0).all()


def test_the_grids_of_older_maps_are_what_they_were():
    assert sensor_named("hdl-64e").grid == AngularGrid()
    assert sensor_named("vlp-16").grid == AngularGrid(-15.0, 2.0, 16)
    assert sensor_named("hdl-32e").grid == AngularGrid(-92.0 / 3.0, (124.0 / 3.0) / 31, 32)
    assert sensor_named("os0-64").grid == AngularGrid(-45.0, 90.0 / 63, 64)
    assert sensor_named("os1-64").grid == AngularGrid(-22.5, 45.0 / 63, 64)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rays_per_scan": 0}, "rays_per_scan is 0, wanted at least 1"),
        ({"fov_deg": 361.0}, "fov_deg is 361.0, wanted up to 360"),
        ({"fov_deg": 0.0}, "fov_deg is 0.0, wanted a finite number above 0"),
        ({"uneven_beams_deg": (1.0, 0.0)}, "uneven_beams_deg does not rise"),
    ],
)
def test_an_impossible_sensor_is_rejected_by_name(wrong, message):
    given = {"name": "x", "grid": AngularGrid(), "source": "a page", "rays_per_scan": 100} | wrong
    with pytest.raises(InvalidParameters, match=message):
        Sensor(**given)
