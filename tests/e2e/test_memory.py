"""The memory of a service that answers: what it does not need is not imported."""

from pathlib import Path

from app.revisions.schemas import BasisOut
from core.encodings.signature import pack_signatures
from tests.support.campus import MAP, PACKED
from tests.support.process import serving
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import upload, wait_for


def test_a_service_stores_scans_and_answers_without_importing_scipy(tmp_path):
    scan = recording(scans=12).scans[4]
    with serving(tmp_path / "data", tmp_path / "log") as server:
        client = server.client
        client.post("/v1/maps", json={"map": "campus"})
        upload(client, "monday", recording(scans=12))
        job = client.post(f"{MAP}/builds", json={"segments": 1}).json()["job"]
        assert wait_for(client, job)["state"] == "done"
        basis = BasisOut.model_validate(client.get(f"{MAP}/basis").json()).to_core()
        query = pack_signatures(basis.encode(basis.image(scan)))
        path = f"{MAP}/localizations"
        assert client.post(f"{path}/scan", content=kitti(scan), headers=KITTI).is_success
        assert client.post(f"{path}/signature", content=query, headers=PACKED).is_success
        mapped = Path(f"/proc/{server.pid}/maps").read_text()
    assert "/numpy/" in mapped
    assert "/scipy/" not in mapped
