"""Vehicles are tracked while the service is stopped or killed, and started again.

As programs of their own, which send signatures that were made before, and with the client, which
makes them: both on the processors of the service.
"""

import asyncio
import json
import os
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from tensormap_client import AsyncTrack, AsyncVehicle, TrackAnswer
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

from app.revisions.schemas import BasisOut
from core.encodings.signature import pack_signatures
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.access import ADMIN, ADMIN_KEY
from tests.support.recording import Recording
from tests.support.service import upload, wait_for
from tests.torture.support.service import Tortured, tortured
from tests.torture.support.sizes import seconds, size

pytestmark = [pytest.mark.torture, pytest.mark.alone]

TRACKS = "/v1/maps/campus/tracks"
VEHICLES = size("vehicles", 50)
PERIOD_S = 0.1
BEFORE_S = seconds("TENSORMAP_TORTURE_TRACKED_S", 5.0)
FEWEST_BEFORE = 2  # answers, before that begins
AFTER_S = 5.0  # within which each goes on, from the service's readiness
LONGEST_S = 60.0
LOST_S = 2.0  # they are saved each second, and a second for that
RIGHT_M = 5.0
SCANS = 360


def simulated(noise_seed: int) -> Recording:
    drive = SimulatedDrive(
        seed=1,
        scans=SCANS,
        stops=False,
        noise_seed=noise_seed,
        sensor=SimulatedSensor(firings=180),
    )
    poses = [Pose.from_row(row) for row in drive.poses]
    return Recording(
        tuple(
            Scan(drive.scan(index).points_m, float(drive.timestamp_s[index]), pose)
            for index, pose in enumerate(poses)
        )
    )


@dataclass(frozen=True)
class Campus:
    """What vehicles send at each scan of the map's drive, and where that is."""

    packed: list[bytes]
    scans: list[np.ndarray]
    positions_m: np.ndarray

    def apart_m(self, scan: int, other: int) -> float:
        return float(np.linalg.norm(self.positions_m[scan] - self.positions_m[other]))


@dataclass
class Vehicle:
    """One that passes a scan of the map's drive with each observation, and drives on without.

    Attributes:
        track: Its name.
        scan: Where it is.
        answers: When each came, at which scan it was asked, and what came.
        refused: What was no answer of a track.
    """

    track: str
    scan: int
    answers: list[tuple[float, int, dict[str, Any]]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    async def drive(self, service: Tortured, campus: Campus, end: asyncio.Event) -> None:
        left_s = time.monotonic()
        while not end.is_set():
            try:
                url = f"ws://127.0.0.1:{service.port}{TRACKS}/{self.track}/stream"
                async with connect(url, additional_headers=ADMIN, open_timeout=30) as stream:
                    self.scan += int((time.monotonic() - left_s) / PERIOD_S)
                    while not end.is_set():
                        left_s = time.monotonic()
                        await self._observe(stream, campus)
                        await asyncio.sleep(max(0.0, left_s + PERIOD_S - time.monotonic()))
            except (OSError, TimeoutError, WebSocketException):  # it is down
                await asyncio.sleep(PERIOD_S)

    async def _observe(self, stream: ClientConnection, campus: Campus) -> None:
        scan = min(self.scan, SCANS - 1)
        await stream.send(campus.packed[scan])
        answer = json.loads(await stream.recv())
        if "observations" in answer:
            self.answers.append((time.monotonic(), scan, answer))
        else:
            self.refused.append(answer["type"])
        self.scan += 1

    def counts(self) -> list[tuple[float, int]]:
        """Return when each answer came, and how many observations the track had then."""
        return [(at_s, answer["observations"]) for at_s, _, answer in self.answers]

    def localized(self, ready_s: float) -> tuple[float, int]:
        """Return how long it took from then until it had a place, and how many observations."""
        after = [(at_s, answer["localized"]) for at_s, _, answer in self.answers if at_s > ready_s]
        for taken, (at_s, localized) in enumerate(after, 1):
            if localized:
                return at_s - ready_s, taken
        return np.inf, len(after)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """A service with a map, and what vehicles send to it."""
    with tortured(tmp_path_factory.mktemp("restarts")) as service:
        mapped = simulated(0)
        with service.client() as client:
            client.post("/v1/maps", json={"map": "campus"}).raise_for_status()
            upload(client, "monday", mapped)
            body = {"segment_length": 60, "encoding": "harmonic"}
            job = client.post("/v1/maps/campus/builds", json=body).raise_for_status().json()["job"]
            assert wait_for(client, job)["state"] == "done"
            basis = BasisOut.model_validate(client.get("/v1/maps/campus/basis").json()).to_core()
        queries = simulated(7).scans
        packed = [pack_signatures(basis.encode(basis.image(scan))) for scan in queries]
        positions_m = np.array([mapped.pose(scan).as_tuple()[:3] for scan in range(SCANS)])
        yield service, Campus(packed, [scan.points_m for scan in queries], positions_m)


@pytest.mark.parametrize("how", ["SIGTERM", "SIGKILL"])
def test_tracks_go_on_after_a_restart_without_a_wrong_answer(fleet, how):
    service, campus = fleet
    with service.client() as client:
        begun = [client.post(TRACKS).raise_for_status().json()["track"] for _ in range(VEHICLES)]
    vehicles = [Vehicle(track, 2 * number) for number, track in enumerate(begun)]
    down_s, ready_s = asyncio.run(restarted(service, campus, vehicles, how))
    wrong = [
        (vehicle.track, at_s - ready_s, scan, answer)
        for vehicle in vehicles
        for at_s, scan, answer in vehicle.answers
        if answer["localized"] and campus.apart_m(answer["scan_index"], scan) > RIGHT_M
    ]
    refused = [name for vehicle in vehicles for name in vehicle.refused]
    again = [vehicle.localized(ready_s) for vehicle in vehicles]
    lost = most_lost(vehicles, down_s, ready_s)
    print(
        f"{how}: {sum(len(vehicle.answers) for vehicle in vehicles)} answers, {len(wrong)} wrong,"
        f" down {ready_s - down_s:.1f} s, all localized {max(again)[0]:.1f} s after readiness,"
        f" by {max(taken for _, taken in again)} observations at most, {lost} lost at most"
        f" (load {os.getloadavg()[0]:.1f})"
    )
    with service.client() as client:
        for track in begun:
            client.delete(f"{TRACKS}/{track}").raise_for_status()
    assert not wrong, wrong[:3]
    assert not refused, refused[:3]
    # A machine that answers fewer than ten a second gets the time for as many observations.
    assert all(s <= AFTER_S or taken <= AFTER_S / PERIOD_S for s, taken in again), again
    assert max(again)[0] < LONGEST_S
    assert lost <= (0 if how == "SIGTERM" else LOST_S / PERIOD_S)
    assert "Traceback" not in service.log.read_text()


@dataclass
class Client:
    """A vehicle with the client; as `Vehicle`."""

    track: AsyncTrack
    scan: int
    answers: list[tuple[float, int, TrackAnswer]] = field(default_factory=list)
    missed: int = 0

    async def drive(self, _: Tortured, campus: Campus, end: asyncio.Event) -> None:
        began_s, begun_at = time.monotonic(), self.scan
        while not end.is_set():
            asked_s = time.monotonic()
            # It drives on, whether it is answered or not.
            self.scan = min(begun_at + int((asked_s - began_s) / PERIOD_S / 4), SCANS - 1)
            answer = await self.track.observe(campus.scans[self.scan], timestamp_s=asked_s)
            if answer is None:
                self.missed += 1
            else:
                assert answer.timestamp_s == asked_s
                self.answers.append((time.monotonic(), self.scan, answer))
            await asyncio.sleep(max(0.0, asked_s + PERIOD_S - time.monotonic()))
        await self.track.close()

    def counts(self) -> list[tuple[float, int]]:
        return [(at_s, answer.observations) for at_s, _, answer in self.answers]

    def localized(self, ready_s: float) -> tuple[float, int]:
        after = [(at_s, a.localized) for at_s, _, a in self.answers if at_s > ready_s]
        for taken, (at_s, localized) in enumerate(after, 1):
            if localized:
                return at_s - ready_s, taken
        return np.inf, len(after)


@pytest.mark.parametrize("how", ["SIGTERM", "SIGKILL"])
def test_vehicles_with_the_client_go_on_after_a_restart_without_a_wrong_answer(fleet, how):
    service, campus = fleet
    url = f"http://127.0.0.1:{service.port}"

    async def driven() -> tuple[list[Client], float, float]:
        with_client = [AsyncVehicle(url, ADMIN_KEY, "campus") for _ in range(VEHICLES)]
        clients = [Client(one.track(), 4 * number) for number, one in enumerate(with_client)]
        down_s, ready_s = await restarted(service, campus, clients, how)
        for one in with_client:
            await one.close()
        return clients, down_s, ready_s

    clients, down_s, ready_s = asyncio.run(driven())
    wrong = [
        (at_s - ready_s, scan, answer)
        for client in clients
        for at_s, scan, answer in client.answers
        if answer.localized and campus.apart_m(answer.scan_index, scan) > RIGHT_M
    ]
    again = [client.localized(ready_s) for client in clients]
    before = sum(at_s < down_s for client in clients for at_s, _, _ in client.answers)
    lost = most_lost(clients, down_s, ready_s)
    print(
        f"{how}, {VEHICLES} clients: {sum(len(client.answers) for client in clients)} answers,"
        f" {before} before, {len(wrong)} wrong, down {ready_s - down_s:.1f} s, all localized"
        f" {max(again)[0]:.1f} s after readiness, by {max(taken for _, taken in again)}"
        f" observations at most, {lost} lost at most (load {os.getloadavg()[0]:.1f})"
    )
    assert not wrong, wrong[:3]
    assert lost <= (0 if how == "SIGTERM" else LOST_S / PERIOD_S)
    assert all(s <= AFTER_S or taken <= AFTER_S / PERIOD_S for s, taken in again), again
    assert max(again)[0] < LONGEST_S
    assert "Traceback" not in service.log.read_text()


def most_lost(vehicles: list[Any], down_s: float, ready_s: float) -> int:
    """Return how many observations a track lost by a restart; none may have been begun again."""
    lost: list[int] = []
    for vehicle in vehicles:
        before = [count for at_s, count in vehicle.counts() if at_s < down_s]
        since = [(at_s, count) for at_s, count in vehicle.counts() if at_s >= down_s]
        assert len(before) >= FEWEST_BEFORE
        assert all(count > 1 for _, count in since), "a track was begun again"
        lost.append(before[-1] + 1 - next(count for at_s, count in since if at_s > ready_s))
    return max(lost)


async def restarted(
    service: Tortured, campus: Campus, vehicles: list[Any], how: str
) -> tuple[float, float]:
    """Restart the service under driving vehicles; return when it ended and when it was ready."""
    end = asyncio.Event()
    driving = [asyncio.create_task(v.drive(service, campus, end)) for v in vehicles]
    begun_s = time.monotonic()
    while any(len(v.answers) < FEWEST_BEFORE for v in vehicles):  # on a machine that is slow
        assert time.monotonic() < begun_s + LONGEST_S, "not all are answered"
        await asyncio.sleep(PERIOD_S)
    await asyncio.sleep(BEFORE_S)
    down_s = time.monotonic()
    await asyncio.to_thread(service.stop if how == "SIGTERM" else service.kill)
    await asyncio.to_thread(service.start, service.port)
    ready_s = time.monotonic()
    while time.monotonic() < ready_s + LONGEST_S:
        await asyncio.sleep(1.0)
        if all(vehicle.localized(ready_s)[0] < np.inf for vehicle in vehicles):
            break
    end.set()
    await asyncio.gather(*driving)
    return down_s, ready_s
