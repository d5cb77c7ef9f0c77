"""One key holds bodies and closures open; another one asks where it is, and is answered in time."""

import asyncio
import os
from pathlib import Path

import pytest

from tests.support.access import ADMIN, ADMIN_KEY, bearer, make
from tests.support.process import Server, serving
from tests.support.recording import recording
from tests.support.service import upload, wait_for
from tests.torture.support.load import Answers, Load, Request, as_json, ask_again_and_again

pytestmark = pytest.mark.torture

MAP = "/v1/maps/campus"
P99_S = 0.5
SECONDS = float(os.environ.get("TORTURE_STARVATION_S", "45"))
SLOW_UPLOADS, SLOW_CLOSURES = 200, 100
JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A service with keys and a built map."""
    folder = tmp_path_factory.mktemp("starvation")
    with serving(folder / "data", folder / "log", admin_key=ADMIN_KEY) as server:
        server.client.headers.update(ADMIN)
        server.client.post("/v1/maps", json={"map": "campus"})
        upload(server.client, "monday", recording())
        job = server.client.post(f"{MAP}/builds", json={"segments": 3}).json()["job"]
        assert wait_for(server.client, job)["state"] == "done"
        yield server


def key(server: Server, *scopes: str) -> dict[str, str]:
    held: dict[str, str] = bearer(make(server.client, *scopes)["secret"])
    return held


def signature_fix(server: Server) -> Request:
    """Return a fix by a signature of another key, as the map's basis makes it."""
    basis = server.client.get(f"{MAP}/basis").json()
    columns = basis["parameters"]["ranks"][1]
    rows = [
        [40.0 / (1 + i + j) for j in range(columns)] for i in range(len(basis["radial_basis"][0]))
    ]
    zeros = [[0.0] * columns for _ in rows]
    body = {
        "basis": basis["basis"],
        "signatures": [{"values_real": rows, "values_imag": zeros}],
    }
    headers = {**JSON, **key(server, "localize")}
    request = Request("POST", f"{MAP}/localizations/signature", headers, as_json(body))
    answer = server.client.post(request.path, content=request.body, headers=headers)
    assert answer.status_code == 200, answer.text
    return request


def slow_upload(server: Server) -> Request:
    headers = {"Content-Type": "application/x-tar", **key(server, "maps:write")}
    return Request("POST", f"{MAP}/drives/slow/scans", headers)


def slow_closures(server: Server) -> Request:
    pairs = [(i % 48, (i * 7 + 11) % 48) for i in range(100)]
    proposals = [
        {
            "first": {"drive": "monday", "scan_index": first},
            "second": {"drive": "monday", "scan_index": second},
        }
        for first, second in pairs
    ]
    headers = {**JSON, **key(server, "localize")}
    return Request("POST", f"{MAP}/loop-closures", headers, as_json({"proposals": proposals}))


def resident_bytes(server: Server) -> int:
    pages = int(Path(f"/proc/{server.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


async def measured(server: Server, request: Request, load: Load, warm_s: float) -> list[Answers]:
    """Return the answers on a kept connection and on new ones while the load is on."""
    await asyncio.sleep(warm_s)
    return list(
        await asyncio.gather(
            *(
                ask_again_and_again(server.port, [request], seconds=SECONDS, kept=kept)
                for kept in (True, False)
            )
        )
    )


def test_a_fix_of_another_key_is_answered_while_one_key_holds_uploads_and_closures_open(served):
    fix, uploads, closures = signature_fix(served), slow_upload(served), slow_closures(served)
    before = resident_bytes(served)

    async def run() -> list[Answers]:
        async with Load(served.port) as load:
            load.trickle(uploads, SLOW_UPLOADS, length=10**9)
            load.repeat(closures, SLOW_CLOSURES)
            answers = await measured(served, fix, load, warm_s=5.0)
            print(f"load: {load.answers.statuses}")
            return answers

    answers = asyncio.run(run())
    grown = resident_bytes(served) - before
    for name, found in zip(("kept", "new"), answers, strict=True):
        print(f"{name}: {found}")
    print(f"grown by {grown / 2**20:.0f} MB")
    for found in answers:
        assert set(found.statuses) == {200}, found
        assert found.quantile(0.99) < P99_S, found
    assert grown < 200 * 2**20


def test_the_service_is_alive_while_the_largest_json_comes_in(served):
    body = b"{" + b",".join(b'"%07d":1' % n for n in range(4 * 2**20 // 12)) + b"}"
    assert len(body) < 4 * 2**20
    unknown_keys = Request("PATCH", MAP, {**JSON, **key(served, "maps:write")}, body)
    before = resident_bytes(served)

    async def run() -> list[Answers]:
        async with Load(served.port) as load:
            load.repeat(unknown_keys, 8)
            return await measured(served, Request("GET", "/livez"), load, warm_s=1.0)

    answers = asyncio.run(run())
    grown = resident_bytes(served) - before
    for name, found in zip(("kept", "new"), answers, strict=True):
        print(f"{name}: {found}")
    print(f"grown by {grown / 2**20:.0f} MB")
    for found in answers:
        assert set(found.statuses) == {200}, found
        assert found.quantile(0.99) < P99_S, found
    assert grown < 200 * 2**20
