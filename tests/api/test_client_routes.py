"""Each route of the service has a method of the client, or a reason why not."""

import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx2
import pytest
import tensormap_client
from tensormap_client import Admin, ClientError

from tests.support.commands import ROOT
from tests.support.service import document

NAME = "(name)"
FILE = Path(__file__)


def downloaded(admin: Admin) -> None:
    """Download a revision, and leave no file."""
    with TemporaryDirectory() as folder:
        admin.download_revision(NAME, NAME, Path(folder) / NAME)


BY_ADMIN: dict[str, Callable[[Admin], Any]] = {
    "GET /v1/maps": lambda admin: list(admin.maps()),
    "POST /v1/maps": lambda admin: admin.create_map(NAME),
    "GET /v1/maps/{map}": lambda admin: admin.map(NAME),
    "PATCH /v1/maps/{map}": lambda admin: admin.update_map(NAME, {"description": "x"}),
    "DELETE /v1/maps/{map}": lambda admin: admin.delete_map(NAME),
    "POST /v1/maps/{map}/anchor": lambda admin: admin.fit_anchor(NAME, NAME, []),
    "GET /v1/recycle-bin": lambda admin: list(admin.recycle_bin()),
    "POST /v1/recycle-bin/{entry}/restore": lambda admin: admin.restore(NAME),
    "DELETE /v1/recycle-bin/{entry}": lambda admin: admin.purge(NAME),
    "GET /v1/maps/{map}/drives": lambda admin: list(admin.drives(NAME)),
    "GET /v1/maps/{map}/drives/{drive}": lambda admin: admin.drive(NAME, NAME),
    "PUT /v1/maps/{map}/drives/{drive}": lambda admin: admin.set_mounting(NAME, NAME, None),
    "PATCH /v1/maps/{map}/drives/{drive}": lambda admin: admin.close_drive(NAME, NAME),
    "DELETE /v1/maps/{map}/drives/{drive}": lambda admin: admin.delete_drive(NAME, NAME),
    "GET /v1/maps/{map}/drives/{drive}/scans/{index}": lambda admin: admin.returns_m(NAME, NAME, 0),
    "GET /v1/maps/{map}/drives/{drive}/poses": lambda admin: list(admin.poses(NAME, NAME)),
    "PUT /v1/maps/{map}/drives/{drive}/poses": lambda admin: admin.put_poses(NAME, NAME, []),
    "GET /v1/maps/{map}/captures": lambda admin: list(admin.captures(NAME)),
    "GET /v1/maps/{map}/drives/{drive}/captures": lambda admin: list(admin.captures(NAME, NAME)),
    "GET /v1/maps/{map}/drives/{drive}/captures/{capture}": (
        lambda admin: admin.capture(NAME, NAME, NAME)
    ),
    "DELETE /v1/maps/{map}/drives/{drive}/captures/{capture}": (
        lambda admin: admin.delete_capture(NAME, NAME, NAME)
    ),
    "POST /v1/maps/{map}/builds": lambda admin: admin.start_build(NAME),
    "GET /v1/jobs": lambda admin: list(admin.jobs()),
    "GET /v1/jobs/{job}": lambda admin: admin.job(NAME),
    "DELETE /v1/jobs/{job}": lambda admin: admin.cancel(NAME),
    "GET /v1/maps/{map}/revisions": lambda admin: list(admin.revisions(NAME)),
    "POST /v1/maps/{map}/revisions": lambda admin: admin.import_revision(NAME, FILE),
    "GET /v1/maps/{map}/revisions/{revision}": lambda admin: admin.revision(NAME, NAME),
    "DELETE /v1/maps/{map}/revisions/{revision}": lambda admin: admin.delete_revision(NAME, NAME),
    "GET /v1/maps/{map}/revisions/{revision}/file": lambda admin: downloaded(admin),
    "GET /v1/maps/{map}/revisions/{revision}/comparison": (
        lambda admin: admin.comparison(NAME, NAME)
    ),
    "PUT /v1/maps/{map}/live": lambda admin: admin.make_live(NAME, NAME),
    "GET /v1/maps/{map}/topology": lambda admin: admin.topology(NAME),
    "GET /v1/maps/{map}/geojson": lambda admin: admin.geojson(NAME),
    "GET /v1/bases": lambda admin: list(admin.bases()),
    "POST /v1/bases": lambda admin: admin.share_basis(NAME, [NAME]),
    "DELETE /v1/bases/{basis}": lambda admin: admin.delete_basis(NAME),
    "GET /v1/keys": lambda admin: list(admin.keys()),
    "POST /v1/keys": lambda admin: admin.make_key(NAME, ["localize"]),
    "GET /v1/keys/{key}": lambda admin: admin.key(NAME),
    "DELETE /v1/keys/{key}": lambda admin: admin.revoke_key(NAME),
    "POST /v1/tokens": lambda admin: admin.exchange_token(),
    "GET /v1/audit": lambda admin: list(admin.audit()),
}

BY_OTHERS = {
    "PUT /v1/maps/{map}/drives/{drive}/scans/{index}": "Mapper.upload",
    "GET /v1/maps/{map}/drives/{drive}/scans": "Mapper.upload",
    "POST /v1/maps/{map}/drives/{drive}/scans": "Mapper.upload",
    "POST /v1/maps/{map}/drives/{drive}/captures": "Mapper.upload",
    "PATCH /v1/maps/{map}/drives/{drive}/captures/{capture}": "Mapper.upload",
    "PUT /v1/maps/{map}/drives/{drive}/captures/{capture}/parts/{part}": "Mapper.upload",
    "GET /v1/maps/{map}/basis": "Vehicle.basis",
    "GET /v1/bases/{basis}": "Locator.locate",
    "POST /v1/maps/{map}/localizations/signature": "Vehicle.locate",
    "POST /v1/localizations/signature": "Locator.locate",
    "POST /v1/maps/{map}/tracks": "Vehicle.track",
    "GET /v1/maps/{map}/tracks/{track}": "Track.observe",
    "DELETE /v1/maps/{map}/tracks/{track}": "Track.close",
    "GET /v1/maps/{map}/tracks/{track}/stream": "Track.observe",
}

SENDS_SIGNATURES = "the client sends signatures, which are a thousandth of a scan"
FOR_PROBES = "for probes, Prometheus and people, who have no client"
BY_NONE = {
    "GET /v1/jobs/{job}/events": "Admin.follow polls the job, which outlasts lost connections",
    "POST /v1/maps/{map}/localizations/scan": SENDS_SIGNATURES,
    "POST /v1/maps/{map}/localizations/image": SENDS_SIGNATURES,
    "POST /v1/localizations/scan": SENDS_SIGNATURES,
    "POST /v1/maps/{map}/localizations/batch": "a vehicle locates itself scan by scan",
    "POST /v1/maps/{map}/loop-closures": "of a SLAM system; `tensormap loop-closure` sends them",
    "GET /v1/maps/{map}/tracks": "of the caller's own tracks, which a Track knows",
    "POST /v1/maps/{map}/tracks/{track}/observations": "a Track has a stream",
    "GET /livez": FOR_PROBES,
    "GET /readyz": FOR_PROBES,
    "GET /version": FOR_PROBES,
    "GET /metrics": FOR_PROBES,
    "GET /problems/{name}": "`tensormap_client.problems` has a class of each",
}


def test_every_route_is_in_one_of_the_tables() -> None:
    routes = [
        f"{method.upper()} {path}"
        for path, operations in document()["paths"].items()
        for method in operations
    ]
    assert sorted(routes) == sorted([*BY_ADMIN, *BY_OTHERS, *BY_NONE])


@pytest.mark.parametrize("route", BY_ADMIN)
def test_a_method_of_an_administrator_sends_a_request_to_its_route(route) -> None:
    sent: list[str] = []

    def service(request: httpx2.Request) -> httpx2.Response:
        sent.append(f"{request.method} {request.url.path}")
        page: dict[str, Any] = {"items": [], "poses": [], "next_after": None, "next_first": None}
        return httpx2.Response(200, json=page)

    with (
        Admin("http://maps.example", connections=httpx2.MockTransport(service)) as admin,
        suppress(ClientError, OSError, ValueError),  # of an answer that is none
    ):
        BY_ADMIN[route](admin)
    pattern = re.sub(r"\{index\}", "0", route)
    assert sent == [re.sub(r"\{\w+\}", lambda _: NAME, pattern)]


def test_the_readme_names_each_method_of_an_administrator() -> None:
    readme = (ROOT / "clients/python/README.md").read_text()
    methods = {name for name in dir(Admin) if not name.startswith("_")} - {"close"}
    assert methods <= set(re.findall(r"`(\w+)`", readme))


@pytest.mark.parametrize("named", sorted(set(BY_OTHERS.values())))
def test_a_method_of_another_class_exists(named) -> None:
    kind, _, method = named.partition(".")
    assert callable(getattr(getattr(tensormap_client, kind), method))
    assert callable(getattr(getattr(tensormap_client, f"Async{kind}"), method))
