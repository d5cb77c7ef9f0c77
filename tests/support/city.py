"""Three districts of a city, each a map, and how tests build them."""

import functools
from pathlib import Path

from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.recording import Recording
from tests.support.service import running, upload, wait_for

DISTRICTS = {"north": 31, "south": 32, "west": 33}
SCANS = 40
BUILT = {"encoding": "harmonic", "lateral_renderings_m": [0]}


@functools.cache
def district(name: str, *, noise_seed: int = 0) -> Recording:
    """Return the drive of a district."""
    drive = SimulatedDrive(
        seed=DISTRICTS[name],
        scans=SCANS,
        stops=False,
        noise_seed=noise_seed,
        sensor=SimulatedSensor(firings=180),
    )
    return Recording(tuple(drive))


def build_district(client, slug, **parameters):
    """Build a district's map, and return its revision."""
    queued = client.post(f"/v1/maps/{slug}/builds", json={**BUILT, **parameters})
    assert queued.status_code == 202, queued.text
    job = wait_for(client, queued.json()["job"])
    assert job["state"] == "done", job
    return job["revision"]


def build_city(data: Path) -> None:
    """Make a service's data: `north` and `south` share a basis, `west` has its own, `east` none."""
    with running(data) as client:
        for slug in (*DISTRICTS, "east"):
            client.post("/v1/maps", json={"map": slug})
        for slug in DISTRICTS:
            upload(client, "monday", district(slug), slug=slug)
        build_district(client, "north")
        shared = client.post("/v1/bases", json={"name": "city", "maps": ["north"]})
        assert shared.status_code == 201, shared.text
        build_district(client, "south", basis="city")
        build_district(client, "west")
