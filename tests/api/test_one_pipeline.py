"""A drive and its parameters give one revision digest by every way of upload."""

import pytest

from app.cli.options import MIN_RETURNS
from core import MapParameters, build_map
from core.errors import Cancelled
from core.evaluation import evaluate as evaluation
from core.mapping.pipeline import build
from core.parameters import Segmentation
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.files.map_file import read_map
from storage.formats.drives.kitti_drive import write_kitti_drive
from storage.formats.drives.layouts import open_drive
from tests.support.commands import tensormap
from tests.support.recording import Recording
from tests.support.service import upload, wait_for

SCANS, K = 24, 8


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives") / "monday"
    drive = SimulatedDrive(seed=0, scans=SCANS, sensor=SimulatedSensor(firings=180))
    write_kitti_drive(drive, folder)
    return folder


def by_service(client, drive, chosen):
    client.post("/v1/maps", json={"map": "campus"})
    scans = tuple(drive.scan(index) for index in range(len(drive)))
    upload(client, drive.name, Recording(scans))
    job = client.post("/v1/maps/campus/builds", json={**chosen, "segment_length": K}).json()
    return wait_for(client, job["job"])["revision"]


def by_command(folder, out, chosen):
    options = [word for name, value in chosen.items() for word in (f"--{name}", value)]
    tensormap("build", folder, "-o", out, "--segment-length", str(K), *options)
    return read_map(out).revision


def by_evaluation(drive, parameters, monkeypatch):
    """Return the digest of the map of a whole drive that a second pass queries."""
    maps = []

    def kept(*arguments, **options):
        maps.append(build(*arguments, **options).tensor_map)
        raise Cancelled  # no query is needed

    monkeypatch.setattr(evaluation, "build", kept)
    protocol = evaluation.EvaluationProtocol(parameters, segment_length=K)
    with pytest.raises(Cancelled):
        evaluation.evaluate(drive, protocol, drive)
    return maps[0].revision


@pytest.mark.parametrize(
    ("encoding", "segmentation"),
    [("harmonic", Segmentation.FIXED), ("paper", Segmentation.UNEQUAL)],
)
def test_service_command_core_and_evaluation_build_one_map(
    empty, folder, tmp_path, monkeypatch, encoding, segmentation
):
    chosen = {"encoding": encoding, "segmentation": segmentation.value}
    drive = open_drive(folder, min_returns=MIN_RETURNS)
    parameters = MapParameters.for_sensor(**chosen)
    digest = build_map(drive, parameters, segment_length=K).revision
    assert by_service(empty, drive, chosen) == digest
    assert by_command(folder, tmp_path / "map.h5", chosen) == digest
    assert by_evaluation(drive, parameters, monkeypatch) == digest
