"""The costliest JSON within the limits, searched for on every route that takes JSON."""

import itertools
import json
import random
import resource
import time
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel

from app.access.key_schemas import KeyIn, TokenIn
from app.builds.parameters import BuildParameters
from app.drives.pose_schemas import PosesIn
from app.drives.schemas import DrivePatch
from app.http.bodies.json_body import MOST_DEPTH, MOST_KEYS, MOST_MEMBERS, MOST_VALUES, read_json
from app.localization.signature_schemas import SignaturesIn
from app.loop_closures.schemas import LoopClosuresIn
from app.maps.schemas import MapIn, MapPatch
from app.revisions.schemas import LiveIn
from app.settings import Settings
from app.tracking.schemas import ObservationIn
from core.errors import TensorMapError
from tests.torture.support.sizes import chance, size

pytestmark = pytest.mark.torture

_BODIES = size("json", 200)  # of two thousand
MOST_BYTES = Settings(_env_file=None).max_json_bytes
MOST_CPU_S, MOST_MEMORY_BYTES = 5.0, 500 * 2**20
MODELS: tuple[type[BaseModel], ...] = (
    BuildParameters,
    DrivePatch,
    KeyIn,
    LiveIn,
    LoopClosuresIn,
    MapIn,
    MapPatch,
    ObservationIn,
    PosesIn,
    SignaturesIn,
    TokenIn,
)


def filled(item: Callable[[int], bytes], most: int, begin: bytes, end: bytes) -> bytes:
    """Return as many items as the limits allow."""
    parts, size = [], len(begin) + len(end)
    for number in range(most):
        part = item(number)
        size += len(part) + 1
        if size > MOST_BYTES:
            break
        parts.append(part)
    return begin + b",".join(parts) + end


def lists(item: Callable[[int], bytes], per_item: int = 1) -> bytes:
    return filled(item, MOST_VALUES // (per_item + 1) - 2, b"[", b"]")


def objects(item: Callable[[int], bytes]) -> bytes:
    return filled(item, MOST_KEYS - 3, b"{", b"}")


def nested(inner: bytes, depth: int, opening: bytes = b"[", closing: bytes = b"]") -> bytes:
    return opening * depth + inner + closing * depth


# Each fills what the limits allow with one kind of value.
VALUES: dict[str, Callable[[], bytes]] = {
    "integers": lambda: lists(lambda n: b"%d" % (n % 10)),
    "floats": lambda: lists(lambda n: b"%.3f" % n),
    "many digits": lambda: lists(lambda n: b"0." + b"%06d" % n + b"7" * 60),
    "huge integers": lambda: lists(lambda _: b"9" * 4_299),
    "integers beyond Python's": lambda: lists(lambda _: b"9" * 5_000),
    "a number of megabytes": lambda: b"1" * (MOST_BYTES - 200),
    "a fraction of megabytes": lambda: b"0." + b"1" * (MOST_BYTES - 200),
    "exponents": lambda: lists(lambda n: b"1e%d" % (n % 300)),
    "overflowing exponents": lambda: lists(lambda _: b"1e999999999"),
    "short texts": lambda: lists(lambda _: b'"a"'),
    "texts of their own": lambda: lists(lambda n: b'"%d"' % n),
    "a text of megabytes": lambda: b'"' + b"a" * (MOST_BYTES - 200) + b'"',
    "escapes": lambda: b'"' + b"\\u0041" * ((MOST_BYTES - 200) // 6) + b'"',
    "wide characters": lambda: b'"' + "\U0001f5fa".encode() * ((MOST_BYTES - 200) // 4) + b'"',
    "empty texts": lambda: lists(lambda _: b'""'),
    "nulls": lambda: lists(lambda _: b"null"),
    "truths": lambda: lists(lambda _: b"true"),
    "empty lists": lambda: lists(lambda _: b"[]", 1),
    "lists of one": lambda: lists(lambda _: b"[0]", 1),
    "deep lists": lambda: lists(lambda _: nested(b"", MOST_DEPTH - 4), MOST_DEPTH - 4),
    "empty objects": lambda: lists(lambda _: b"{}", 1),
    "keys of their own": lambda: objects(lambda n: b'"%d":1' % n),
    "long keys": lambda: objects(lambda n: b'"%070d":1' % n),
    "keys of lists": lambda: objects(lambda n: b'"%d":[[]]' % n),
    "a key again and again": lambda: objects(lambda _: b'"a":1'),
    "objects of one": lambda: filled(lambda n: b'{"a":%d}' % n, MOST_KEYS - 4, b"[", b"]"),
    "objects of unknown keys": lambda: filled(
        lambda n: b'{"%d":0,"%d":0}' % (n, n + 1), (MOST_KEYS - 6) // 2, b"[", b"]"
    ),
    "objects of many unknown keys": lambda: filled(
        lambda _: json.dumps(dict.fromkeys(map(str, range(MOST_MEMBERS)), 0)).encode(),
        MOST_KEYS // MOST_MEMBERS - 1,
        b"[",
        b"]",
    ),
    "blanks": lambda: b" " * (MOST_BYTES - 200) + b"1",
}


@dataclass(frozen=True)
class Cost:
    """What reading a body took."""

    cpu_s: float
    peak_bytes: int
    outcome: str


def cost_of(body: bytes, model: type[BaseModel], *, memory: bool) -> Cost:
    assert len(body) <= MOST_BYTES
    outcome = "read"
    if memory:
        tracemalloc.start()
    began = time.thread_time()
    try:
        read_json(body, model)
    except (TensorMapError, RequestValidationError) as error:
        outcome = type(error).__name__
    finally:
        took = time.thread_time() - began
        peak = 0
        if memory:
            _, peak = tracemalloc.get_traced_memory()
            tracemalloc.stop()
    return Cost(took, peak, outcome)


_LARGE = {BuildParameters, KeyIn, LoopClosuresIn, PosesIn, SignaturesIn}


def places(model: type[BaseModel]) -> Iterator[tuple[str, Callable[[bytes], bytes]]]:
    """Yield where a value may be: as the whole body, or in a field that the API describes."""
    yield "body", lambda value: value
    yield "unknown", lambda value: b'{"unknown":' + value + b"}"
    for name in model.model_fields if model in _LARGE else ():
        yield name, lambda value, name=name: b'{"%s":%s}' % (name.encode(), value)  # type: ignore[misc]
    if model is PosesIn:
        yield "poses/0", lambda value: b'{"poses":[' + value + b"]}"
        yield "poses/pose", lambda value: b'{"poses":[{"scan":0,"pose":' + value + b"}]}"
    if model in {SignaturesIn, ObservationIn}:
        named = b'{"basis":"' + b"0f" * 32 + b'","signatures":['
        yield "signatures/0", lambda value: named + value + b"]}"
        for field in (b"values", b"values_real", b"segment"):
            yield (
                f"signatures/0/{field.decode()}",
                lambda value, field=field: named + b'{"%s":%s}]}' % (field, value),  # type: ignore[misc]
            )
    if model is LoopClosuresIn:
        yield "proposals/0", lambda value: b'{"proposals":[' + value + b"]}"
        yield "first", lambda value: b'{"proposals":[{"first":' + value + b"}]}"
        yield (
            "second/signatures",
            lambda value: b'{"proposals":[{"second":{"signatures":' + value + b"}}]}",
        )


def well_formed() -> Iterator[tuple[str, type[BaseModel], bytes]]:
    """Yield the largest bodies that a client may mean."""
    poses = [
        {"scan": n, "pose": [1.5, -2.0, 1.73, 0.0, 0.0, 0.0, 1.0], "timestamp_s": n + 0.5}
        for n in range(10_000)
    ]
    yield "10,000 poses", PosesIn, json.dumps({"poses": poses}).encode()
    wrong = [{"scan": n, "pose": [True] * 7} for n in range(10_000)]
    yield "10,000 wrong poses", PosesIn, json.dumps({"poses": wrong}).encode()
    unknown = [{"scan": n, "x": 1, "y": 2, "z": 3} for n in range(10_000)]
    yield "10,000 poses of unknown keys", PosesIn, json.dumps({"poses": unknown}).encode()
    rows = [[round(0.1 * n, 3) for n in range(5)]] * 5
    many = [{"segment": n, "values": rows} for n in range(16_000)]
    text = json.dumps({"basis": "0f" * 32, "signatures": many}, separators=(",", ":")).encode()
    for model in (SignaturesIn, ObservationIn):
        yield "16,000 signatures", model, text[:MOST_BYTES]
    proposal = {
        "first": {"drive": "d", "scan_index": 0},
        "second": {"basis": "0f" * 32, "signatures": many[:170]},
    }
    closures = json.dumps({"proposals": [proposal] * 100}, separators=(",", ":")).encode()
    yield "100 proposals by signature", LoopClosuresIn, closures[:MOST_BYTES]
    names = [f"d{n}" for n in range(1_000)]
    yield "1,000 drives", BuildParameters, json.dumps({"drives": names}).encode()
    yield (
        "1,000 maps",
        KeyIn,
        json.dumps({"name": "k", "scopes": ["admin"], "maps": names}).encode(),
    )


def test_the_worst_json_costs_seconds_and_little_memory():
    found: list[tuple[Cost, str]] = []
    bodies = {name: make() for name, make in VALUES.items()}
    cases = [
        (model, put, value, f"{model.__name__} {place} {name}")
        for model in MODELS
        for (place, put), (name, value) in itertools.product(places(model), bodies.items())
    ]
    for model, put, value, case in chance("json").sample(cases, min(_BODIES, len(cases))):
        body = put(value)
        if len(body) <= MOST_BYTES:
            found.append((cost_of(body, model, memory=False), case))
    for name, model, body in well_formed():
        found.append((cost_of(body, model, memory=False), f"{model.__name__} {name}"))
    found.sort(key=lambda pair: -pair[0].cpu_s)
    for cost, name in found[:8]:
        print(f"{cost.cpu_s:.2f} s {name}: {cost.outcome}")
    print(f"{len(found)} bodies; peak {peak_mb()} MB")
    assert found[0][0].cpu_s < MOST_CPU_S


def test_the_worst_json_takes_little_memory():
    found: list[tuple[Cost, str]] = []
    bodies = {name: make() for name, make in VALUES.items()}
    cases = [
        (model, put, value, f"{model.__name__} {place} {name}")
        for model in (MapIn, PosesIn, SignaturesIn, LoopClosuresIn)
        for (place, put), (name, value) in itertools.product(places(model), bodies.items())
        if name not in {"huge integers", "integers beyond Python's"}
    ]
    chosen: list[tuple[type[BaseModel], bytes, str]] = [
        (model, put(value), name) for model, put, value, name in random.Random(13).sample(cases, 40)
    ]
    chosen += [(model, body, f"{model.__name__} {name}") for name, model, body in well_formed()]
    for model, body, name in chosen:
        if len(body) <= MOST_BYTES:
            found.append((cost_of(body, model, memory=True), name))
    found.sort(key=lambda pair: -pair[0].peak_bytes)
    for cost, name in found[:8]:
        print(f"{cost.peak_bytes / 2**20:.0f} MB {name}: {cost.outcome}")
    assert found[0][0].peak_bytes < MOST_MEMORY_BYTES


def test_a_mutated_body_costs_no_more():
    """Bodies put together at random of what the others are made of: broken, and in a field."""
    chosen = chance("mutated")
    worst, reached = (0.0, b""), 0
    for number in range(30):
        model = chosen.choice(MODELS)
        makers = chosen.choices(list(VALUES.values()), k=chosen.randint(1, 4))
        if number % 2:
            _, put = chosen.choice(list(places(model)))
            body = put(json.dumps([part(make(), len(makers)) for make in makers]).encode())
        else:
            pieces = [make()[: MOST_BYTES // len(makers) - 100] for make in makers]
            body = b"[" + b",".join(pieces) + b"]"
        cost = cost_of(body[:MOST_BYTES], model, memory=False)
        worst = max(worst, (cost.cpu_s, body[:60]))
        reached += number % 2 and cost.outcome in {"read", "RequestValidationError"}
    assert worst[0] < MOST_CPU_S, worst
    assert reached, "no body was JSON that a model refused"


def part(value: bytes, parts: int) -> object:
    """Return one of equal parts of a value, still JSON; `None` if it cannot be taken apart."""
    try:
        found = json.loads(value, parse_constant=lambda _: 0)
    except ValueError:  # a number of more digits than Python takes
        return None
    if isinstance(found, dict):
        return dict(itertools.islice(found.items(), len(found) // parts))
    if isinstance(found, str | list):
        return found[: len(found) // parts]
    return found


def peak_mb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
