"""A fleet on WebSockets: each vehicle sends signatures at a fixed rate and checks every answer."""

import asyncio
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from websockets.asyncio.client import connect

from tests.torture.support.load import Request, answer_to

RATE_HZ = 10.0
_LATEST_S = 5.0  # the service does not keep up
_NEAR_SCANS = 10  # of the map, between a vehicle's place and the answer
_PACKED = {"Content-Type": "application/vnd.tensormap.signature"}


@dataclass
class Fleet:
    """What the vehicles of one process observed.

    Attributes:
        seconds: From when each observation was due to its answer.
        tracks: How many were driven.
        localized: How many answers were localized.
        astray: How many of these were not near the vehicle.
        faults: Answers that are of another track or number of observation, or are problems.
    """

    seconds: list[float] = field(default_factory=list)
    tracks: int = 0
    localized: int = 0
    astray: int = 0
    faults: list[str] = field(default_factory=list)

    def quantile(self, share: float) -> float:
        """Return the seconds within which this share of the observations was answered."""
        return sorted(self.seconds)[int(share * (len(self.seconds) - 1))]

    def __str__(self) -> str:
        p50, p99, most = (1e3 * self.quantile(share) for share in (0.5, 0.99, 1.0))
        return (
            f"{len(self.seconds)} observations of {self.tracks} tracks, p50 {p50:.1f} p99"
            f" {p99:.1f} most {most:.0f} ms; {self.localized} localized, {self.astray} of them"
            " astray"
        )


async def drive(
    port: int,
    path: str,
    headers: Mapping[str, str],
    bodies: Sequence[bytes],
    vehicles: int,
    for_s: float,
    *,
    patient: bool,
) -> Fleet:
    """Drive vehicles along a map, again from its beginning when they are at its end.

    Args:
        port: Of the service.
        path: Of the map.
        headers: With the key.
        bodies: Packed signatures of a vehicle at each scan of the map.
        vehicles: How many, evenly spread along it.
        for_s: How long.
        patient: Whether a vehicle whose answer comes late waits a period from then on; otherwise
            it keeps to its times, and sends what is overdue at once.
    """
    fleet, ends = Fleet(), time.perf_counter() + for_s

    async def vehicle(number: int) -> None:
        begins = number * len(bodies) // vehicles
        await asyncio.sleep(number / vehicles / RATE_HZ)
        while time.perf_counter() < ends and not fleet.faults:
            begun = await answer_to(port, Request("POST", f"{path}/tracks", headers))
            if begun[0] != 201:
                fleet.faults.append(f"a new track: {begun}")
                return
            track = json.loads(begun[1])["track"]
            fleet.tracks += 1
            of_track = f"{path}/tracks/{track}"
            url = f"ws://127.0.0.1:{port}{of_track}/stream"
            async with connect(url, additional_headers=dict(headers)) as stream:
                due = time.perf_counter()
                for index in range(begins, len(bodies)):
                    if patient:
                        due = max(due, time.perf_counter())
                    due += 1.0 / RATE_HZ
                    if due >= ends:
                        break
                    await asyncio.sleep(due - time.perf_counter())
                    await stream.send(bodies[index])
                    answer = json.loads(await stream.recv())
                    fleet.seconds.append(time.perf_counter() - due)
                    if fleet.seconds[-1] > _LATEST_S:
                        fleet.faults.append(f"an answer came {fleet.seconds[-1]:.1f} s late")
                        return
                    _check(fleet, answer, track, 1 + index - begins, index)
            await answer_to(port, Request("DELETE", of_track, headers))
            begins = 0

    await asyncio.gather(*(vehicle(number) for number in range(vehicles)))
    return fleet


def _check(fleet: Fleet, answer: dict[str, object], track: str, count: int, index: int) -> None:
    """Note an answer that is not that to the `count`-th observation of a track, at scan `index`."""
    found = answer.get("track"), answer.get("observations")
    if found != (track, count):
        fleet.faults.append(f"wanted {(track, count)}, got {found}: {str(answer)[:300]}")
    elif answer["localized"]:
        fleet.localized += 1
        fleet.astray += abs(int(str(answer["scan_index"])) - index) > _NEAR_SCANS


def run(
    port: int,
    path: str,
    key: Mapping[str, str],
    bodies: Sequence[bytes],
    vehicles: int,
    for_s: float,
    *,
    patient: bool,
) -> Fleet:
    """Drive vehicles in this process, and return what they observed; see `drive`."""
    return asyncio.run(
        drive(port, path, {**key, **_PACKED}, bodies, vehicles, for_s, patient=patient)
    )
