"""Every operation of the OpenAPI document, under all the checks of schemathesis.

Operations that change something run on a copy each of a service that has a built map, the others on
one copy, with an administrator's key.
All checks are on. Two do not apply here: `object_level_authorization` compares several
sign-ups of one service, which has none (test_scopes.py requests every pair of route and scope), and
`max_response_time` is off by its own default, a limit on a machine that others use too.
"""

import itertools
import os
from contextlib import contextmanager
from copy import deepcopy

import pytest
import schemathesis
from pydantic import SecretStr
from schemathesis.config import SchemathesisConfig
from schemathesis.generation.feedback import NO_FEEDBACK
from schemathesis.openapi.checks import RejectedPositiveData
from schemathesis.pytest._test_builder import build_operation_test

from app.main import create_app
from app.settings import Settings
from tests.support.conformance import Bridge, KnownNames, register_bodies, without_long_lists
from tests.support.recording import recording, upload_scan
from tests.support.service import Client, copy_of, document

KEY = "correct horse battery staple"
HEADERS = {"Authorization": f"Bearer {KEY}"}
EVERY_DAY = 5
EXAMPLES = int(os.environ.get("TENSORMAP_SCHEMATHESIS_EXAMPLES", EVERY_DAY))
SPARES = 12

OF_MEANING = {
    # Only their readers know which bytes are a scan, an image, a map or an archive.
    *("empty-body", "truncated-scan", "wrong-dtype", "malformed-scan", "too-few-returns"),
    *("invalid-scan", "scan-too-large", "unknown-format", "invalid-image", "invalid-map"),
    *("malformed-upload", "nothing-stored"),
    # Numbers that belong together: a prior's, a quaternion's, a signature's rows, ranks and a grid;
    # and cursors, which are made by the list that they are for.
    *("invalid-parameters", "invalid-pose", "invalid-signature"),
    # Files that are no recording together, and what a capture has announced.
    *("unknown-drive-layout", "capture-too-large", "part-does-not-fit"),
    # Not a WebSocket: the document has no word for one.
    "upgrade-required",
    # Not of this map, or no longer.
    *("unknown-segment", "sensor-mismatch", "empty-drive", "map-changed"),
}
"""Problems of a request that matches its schema."""
OF_SCHEMA = (
    *("should ", "is missing", "is no field", "is no JSON", "the route has no", "came "),
    *("wanted true or false", "wanted a moment as", "an item comes twice"),
)
"""How a problem begins that its schema describes; all others are of rules of our own."""

OPERATIONS = sorted(
    f"{method.upper()} {path}"
    for path, operations in document()["paths"].items()
    for method in operations
)

EVENT = {
    "type": "object",
    "required": ["data", "id"],
    "properties": {
        "data": {
            "type": "string",
            "contentMediaType": "application/json",
            "contentSchema": {"$ref": "#/components/schemas/JobOut"},
        },
        "id": {"type": "string"},
    },
}
"""An event of a job: OpenAPI 3.1 describes a stream as one text, schemathesis validates each."""

bridge = Bridge()
known = KnownNames()


@pytest.fixture(scope="module")
def api(built):
    """The document as schemathesis reads it."""
    described = deepcopy(document() if EXAMPLES > EVERY_DAY else without_long_lists(document()))
    events = described["paths"]["/v1/jobs/{job}/events"]["get"]["responses"]["200"]
    events["content"] = {"text/event-stream": {"itemSchema": EVENT}}
    expected = {
        "seed": 1,
        "request-timeout": 60,
        "suppress-health-check": ["all"],
        "generation": {
            "max-examples": EXAMPLES,
            "deterministic": True,
            "database": "none",
            # The key is put into each request, except those of the check without a key.
            "with-security-parameters": False,
        },
    }
    api = schemathesis.openapi.from_dict(described, config=SchemathesisConfig.from_dict(expected))
    api.app = bridge

    @api.hook
    def filter_failure(context, failure, case, response):
        positive = isinstance(failure, RejectedPositiveData)
        return not (positive and is_refused_for_its_meaning(response))

    def live():
        return bridge.app.state.service.revisions.live("campus").localizer

    register_bodies(live, lambda: next(built.data_dir.rglob(f"{built.live}*")).read_bytes())
    return api


def is_refused_for_its_meaning(response):
    """Whether a request matched its schema, and is rejected for what no schema describes."""
    if response.headers["content-type"] != ["application/problem+json"]:
        return False
    problem = response.json()
    name = problem["type"].removeprefix("/problems/")
    if name == "invalid-request":  # by a rule of our own, of several fields together
        answer = problem.get("errors", ())
        return answer and not any(error["what"].startswith(OF_SCHEMA) for error in answer)
    return name in OF_MEANING


@contextmanager
def serving(data_dir, built, deletes=""):
    """Run a service; yield its application, and the names that it has."""
    app = create_app(Settings(data_dir=copy_of(built.data_dir, data_dir), admin_key=SecretStr(KEY)))
    with Client(app, headers=HEADERS) as client:
        yield app, names_of(client, built, deletes)


@pytest.fixture(scope="module")
def unchanged(tmp_path_factory, built):
    """The service of all operations that read."""
    with serving(tmp_path_factory.mktemp("unchanged") / "data", built) as found:
        yield found


@pytest.fixture
def changed(request, tmp_path, built):
    """The service of one operation."""
    method, path = request.node.callspec.params["operation"].split()
    deletes = path.rpartition("/")[2] if method == "DELETE" else ""
    with serving(tmp_path / "data", built, deletes) as (app, names):
        app.state.service.runner.stop()  # nothing is built: builds have tests of their own
        yield app, names


def names_of(client, built, deletes):
    """Return the existing names, by their place in requests."""

    def make(path, **body):
        made = client.post(path, json=body)
        assert made.status_code == 201, made.text
        return made.json()

    # Each request that deletes has one of its own.
    more = range(SPARES if deletes else 1)
    maps, drives = ["campus"], ["monday"]
    if deletes == "{map}":
        maps = [make("/v1/maps", map=f"spare-{number}")["map"] for number in more]
    if deletes == "{drive}":
        drives = [f"spare-{number}" for number in more]
        for drive in drives:
            upload_scan(client, "campus", drive, 0, recording().scans[0])
    names = {
        "path.map": maps,
        "path.drive": drives,
        "path.job": [built.job],
        "path.revision": [built.other] if deletes else [built.live, built.other[:16]],
        "path.key": [make("/v1/keys", name="fleet", scopes=["localize"])["key"] for _ in more],
        "path.track": [make("/v1/maps/campus/tracks")["track"] for _ in more],
        "query.revision": [built.live, built.other[:12]],
        "query.since_drive": ["monday"],
        "body.revision": [built.live, built.other],
        "body.base": ["live"],
        "body.basis": [client.get("/v1/maps/campus/basis").json()["basis"]],
    }
    return {place: itertools.cycle(of_place) for place, of_place in names.items()}


@pytest.mark.parametrize("operation", OPERATIONS)
def test_an_operation_is_as_it_is_described(operation, api, request):
    method, path = operation.split()
    service = "unchanged" if method == "GET" else "changed"
    bridge.app, known.of = request.getfixturevalue(service)
    # The pytest plugin of schemathesis 4.32 reads what pytest 9.2 no longer has: this is what it
    # would call.
    build_operation_test(
        config=api.config,
        operation=api[path][method],
        test_func=call,
        given_kwargs={},
        feedback=NO_FEEDBACK,
    )()


def call(case):
    known.put_into(case)
    if (
        case.meta.generation.mode.is_positive
        and isinstance(case.body, dict)
        and "proposals" in case.body
    ):
        del case.body["proposals"][1:]  # a tenth of a second each
    case.call_and_validate(headers=HEADERS)
