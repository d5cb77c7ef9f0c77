"""Vehicles at 10 Hz over WebSockets: all answered in time, nothing lost and nothing mixed up.

`make soak` drives fifty for ten minutes, `.ci/run` five for 40 s: each observation takes some
milliseconds of CPU. The vehicles are a process of their own. The bar of `make soak`, 50 ms, is for
two cores that do nothing else, and its vehicles keep to their times. Without a bar they wait where
a slow machine answers late, so that what is overdue does not pile up.
"""

import os
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import pytest

from core.encodings.signature import pack_signatures
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from storage.files.map_file import write_map
from tests.torture.support import fleet
from tests.torture.support.bodies import HDF5
from tests.torture.support.service import tortured
from tests.torture.support.sizes import seconds, size
from tests.torture.support.watching import Meter, cpu_s

pytestmark = [pytest.mark.torture, pytest.mark.alone, pytest.mark.soak]

MAP = "/v1/maps/streets"
FLEET_S = seconds("TENSORMAP_FLEET_S", 40.0)
P99_S = seconds("TENSORMAP_FLEET_P99_MS", 0.0) / 1e3  # 0: no bar
VEHICLES, SCANS = size("vehicles", 5), size("fleet_scans", 800)
LEFT_M = 0.7  # of the mapped line
WARM_SHARE, EVERY_S = 0.3, 1.0
LEAST_LOCALIZED, MOST_ASTRAY = 0.5, 0.03


def streets(noise_seed: int | None = None, left_m: float = 0.0) -> SimulatedDrive:
    sensor = SimulatedSensor(firings=180)
    return SimulatedDrive(
        seed=1,
        scans=SCANS,
        sensor=sensor,
        stops=False,
        noise_seed=noise_seed,
        lateral_offset_m=left_m,
    )


@pytest.fixture(scope="module")
def queried(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[bytes]]:
    """The file of a map, and the signatures of a vehicle beside its line."""
    made = build_map(streets(), MapParameters.for_sensor(encoding="harmonic"))
    path = tmp_path_factory.mktemp("streets") / "map.h5"
    write_map(path, made)
    basis = Localizer(made).basis
    beside = streets(7, LEFT_M)
    signatures = (basis.encode(basis.image(beside.scan(index))) for index in range(SCANS))
    return path.read_bytes(), [pack_signatures(some) for some in signatures]


def test_every_vehicle_of_a_fleet_is_answered_in_time_and_about_itself(
    tmp_path: Path, queried: tuple[bytes, list[bytes]]
) -> None:
    file, bodies = queried
    with tortured(tmp_path) as service:
        with service.client() as admin:
            admin.post("/v1/maps", json={"map": "streets"}).raise_for_status()
            admin.post(f"{MAP}/revisions", content=file, headers=HDF5).raise_for_status()
            wanted = {"name": "a fleet", "scopes": ["localize"]}
            secret = admin.post("/v1/keys", json=wanted).raise_for_status().json()["secret"]
        key = {"Authorization": f"Bearer {secret}"}
        meter, began, spent_s = Meter(service), time.monotonic(), cpu_s(service.pid)
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
            driven = partial(fleet.run, patient=not P99_S)
            driving = alone.submit(driven, service.port, MAP, key, bodies, VEHICLES, FLEET_S)
            while not driving.done():
                meter.look()
                time.sleep(EVERY_S)
            found = driving.result()
        cpu_ms = 1e3 * (cpu_s(service.pid) - spent_s) / len(found.seconds)
        print(f"{VEHICLES} vehicles, {SCANS} scans: {found}, CPU {cpu_ms:.1f} ms each")
        print(f"load average {os.getloadavg()[0]:.1f}")
        assert not found.faults, found.faults[:3]
        assert found.localized > LEAST_LOCALIZED * len(found.seconds)
        assert found.astray <= MOST_ASTRAY * found.localized
        wrong = meter.faults(began + WARM_SHARE * FLEET_S)
        assert not wrong, wrong
        assert service.pid in meter.measured
        if P99_S:
            assert found.quantile(0.99) < P99_S, f"p99 is {found.quantile(0.99):.3f} s"
        assert "Traceback" not in service.log.read_text(errors="replace")
