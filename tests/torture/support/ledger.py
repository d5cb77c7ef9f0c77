"""What a service has acknowledged, written down by its clients, to compare with after a kill."""

import json
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import httpx2

from tests.torture.support.bodies import digest_of_file, digest_of_npy
from tests.torture.support.service import Tortured, named
from tests.torture.support.writes import poses_of

Thing = tuple[str, ...]
"""What can be read back: its kind, and where it is. Its value is text, `None` where it is not."""


class Refused(Exception):
    """The service answered with a refusal: nothing was changed."""


@dataclass
class _Known:
    value: str | None = None
    maybe: set[str | None] = field(default_factory=set)


class Ledger:
    """What was acknowledged, and what was requested without an answer: that may be there or not."""

    def __init__(self) -> None:
        self._known: dict[Thing, _Known] = {}
        self._lock = threading.Lock()
        self.acknowledged = 0
        self.unanswered = 0

    @contextmanager
    def writing(self, things: Mapping[Thing, str | None]) -> Iterator[None]:
        """Note what a request is to change; when the block ends, it is acknowledged.

        A block that raises `Refused` changes nothing; after any other error it is unknown.
        """
        with self._lock:
            for thing, value in things.items():
                self._known.setdefault(thing, _Known()).maybe.add(value)
        try:
            yield
        except Refused:
            with self._lock:
                for thing, value in things.items():
                    self._known[thing].maybe.discard(value)
            raise
        except BaseException:
            with self._lock:
                self.unanswered += 1
            raise
        with self._lock:
            self.acknowledged += 1
            for thing, value in things.items():
                self._known[thing] = _Known(value)

    def note(self, thing: Thing, value: str | None) -> None:
        """Note the content of an answer."""
        with self._lock:
            self._known[thing] = _Known(value)

    def value(self, thing: Thing) -> str | None:
        """Return what was acknowledged last."""
        with self._lock:
            known = self._known.get(thing)
            return None if known is None else known.value

    def allowed(self, thing: Thing) -> set[str | None]:
        """Return what it may be now."""
        with self._lock:
            known = self._known[thing]
            return {known.value} | known.maybe

    def things(self, *, unsettled: bool = False) -> list[Thing]:
        """Return all that was ever written, or whose state is unknown."""
        with self._lock:
            return [t for t, known in self._known.items() if known.maybe or not unsettled]


def require_acknowledged(
    service: Tortured, client: httpx2.Client, ledger: Ledger, things: Iterable[Thing]
) -> None:
    """Read things back, require each to be what it may be, and note what it is."""
    wrong = []
    for thing in things:
        found, allowed = read_thing(service, client, thing), ledger.allowed(thing)
        if found not in allowed:
            wrong.append(f"{thing} is {found}, acknowledged was {allowed}")
        else:
            ledger.note(thing, found)
    assert not wrong, f"{len(wrong)} lost: {wrong[:5]}"


def read_thing(service: Tortured, client: httpx2.Client, thing: Thing) -> str | None:
    """Return what a service holds."""
    kind, *where = thing
    match kind, where:
        case "scan", [of_map, drive, index]:
            path = f"/v1/maps/{of_map}/drives/{drive}/scans/{index}"
            return _read(client, path, lambda got: digest_of_npy(got.content))
        case "pose", [of_map, drive, index]:
            pose = poses_of(service.data_dir, of_map, drive).get(int(index))
            return None if pose is None else json.dumps(pose)
        case "closed", [of_map, drive]:
            path = f"/v1/maps/{of_map}/drives/{drive}"
            return _read(client, path, lambda got: "closed" if got.json()["closed"] else None)
        case "revision", [of_map, digest]:
            path = f"/v1/maps/{of_map}/revisions/{digest}/file"
            return _read(client, path, lambda got: digest_of_file(got.content))
        case "live", [of_map]:
            return _read(client, f"/v1/maps/{of_map}", lambda got: got.json()["live_revision"])
        case "key", [_, secret]:
            with service.client(secret) as holder:
                status = holder.get("/v1/maps").status_code
            return {200: "opens", 401: None}[status]
    raise ValueError(f"{thing} is of no kind that can be read")


def _read(client, path, value) -> str | None:
    answer = client.get(path)
    if answer.status_code == 404:
        return None
    assert answer.is_success, f"{path}: {named(answer)}: {answer.text[:300]}"
    found: str | None = value(answer)
    return found
