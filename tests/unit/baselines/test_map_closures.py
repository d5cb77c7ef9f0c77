"""The adapter of map_closures, with a fake detector."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from baselines import map_closures as adapter
from baselines.roster import METHODS, default_methods, methods_named
from core.errors import EmptyDrive, InvalidParameters
from tests.support.samples import FaultyDrive, RecordedProgress, sample_drive


class Config:
    def model_dump(self):
        return {"density_map_resolution": 0.5}


class Detector:
    made: "list[Detector]" = []  # noqa: RUF012

    def __init__(self):
        self.kept, self.queried, self.closures = [], [], []
        self.made.append(self)

    def get_best_closure(self, index, points):
        assert points.dtype == np.float64
        self.kept.append(index)

    def get_closures(self, index, points):
        self.queried.append(index)
        return self.closures

    def save_hbst_database(self, path):
        Path(path).write_bytes(bytes(10 * len(self.kept)))


def closure(source, inliers, relative_yaw_deg=0.0):
    cos, sin = np.cos(np.radians(relative_yaw_deg)), np.sin(np.radians(relative_yaw_deg))
    pose = np.eye(4)
    pose[:2, :2] = [[cos, -sin], [sin, cos]]
    return SimpleNamespace(source_id=source, target_id=9, number_of_inliers=inliers, pose=pose)


@pytest.fixture
def installed(monkeypatch):
    package, detector, config = (
        ModuleType(name)
        for name in ("map_closures", "map_closures.map_closures", "map_closures.config")
    )
    vars(detector)["MapClosures"] = Detector
    vars(config)["MapClosuresConfig"] = Config
    for module in (package, detector, config):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(adapter, "is_installed", lambda: True)
    monkeypatch.setattr(adapter, "version", lambda _: "9.9")


def test_the_most_inliers_among_the_places_win(installed):
    progress = RecordedProgress()
    drive = FaultyDrive(sample_drive(5), {1})
    places = adapter.MapClosures().enrol(drive, np.arange(5), progress)
    assert places.scans.tolist() == [0, 2, 3, 4]
    detector = Detector.made[-1]
    assert (detector.kept, places.stored_bytes) == ([0, 1, 2, 3], 10.0)
    assert (progress.stages, progress.done) == ([("map-closures", 5)], [5])
    match = places.describe(drive.scan(0))
    assert match(None) is None
    detector.closures = [closure(1, 7), closure(3, 12, -30.0), closure(1_000_001, 40)]
    found = match(None)
    assert found is not None
    assert (found.row, found.distance) == (3, 1 / 13)
    assert found.relative_yaw_deg == pytest.approx(30.0)
    earlier = match(2)
    assert earlier is not None
    assert earlier.row == 1
    assert match(1) is None
    assert min(detector.queried) > 4
    assert len(set(detector.queried)) == len(detector.queried)


def test_the_configuration_has_the_version(installed):
    configuration = adapter.MapClosures().configuration()
    assert configuration == {"version": "9.9", "density_map_resolution": 0.5}


def test_a_drive_without_a_usable_scan_is_rejected(installed):
    with pytest.raises(EmptyDrive):
        adapter.MapClosures().enrol(FaultyDrive(sample_drive(1), {0}), np.arange(1))


def test_without_the_package_the_method_is_left_out_or_rejected_by_name(monkeypatch):
    monkeypatch.setattr(adapter, "is_installed", lambda: False)
    monkeypatch.setattr("baselines.roster.is_installed", lambda: False)
    assert default_methods() == METHODS[:-1]
    with pytest.raises(InvalidParameters, match="pip install --no-deps map_closures"):
        methods_named(["map-closures"], sensor="hdl-64e", sensor_height_m=1.73, segment_length=9)
    monkeypatch.setattr("baselines.roster.is_installed", lambda: True)
    assert default_methods() == METHODS


def test_solid_looks_where_the_sensor_does():
    [solid] = methods_named(["solid"], sensor="vlp-16", sensor_height_m=1.0, segment_length=9)
    configuration = solid.configuration()
    assert configuration["elevation_min_deg"] == pytest.approx(-16.0)
    assert configuration["elevation_max_deg"] == pytest.approx(16.0)
