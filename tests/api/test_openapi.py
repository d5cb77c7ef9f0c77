"""The OpenAPI document: complete, consistent, and readable without the internet."""

import asyncio
import re
from concurrent.futures import ThreadPoolExecutor
from html.parser import HTMLParser

import pytest

from app.http.errors import KEY, STATUS, InternalError
from app.http.problems import problem_name
from tests.support.service import running


@pytest.fixture(scope="module")
def document(client):
    return client.get("/openapi.json").json()


def operations(document):
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def walk(node):
    yield node
    for below in (
        node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    ):
        yield from walk(below)


def test_every_reference_leads_somewhere(document):
    references = [
        node["$ref"] for node in walk(document) if isinstance(node, dict) and "$ref" in node
    ]
    assert references
    for reference in references:
        place = document
        for part in reference.removeprefix("#/").split("/"):
            assert part in place, reference
            place = place[part]


def test_every_route_is_explained(document):
    for name, operation in operations(document):
        assert operation["summary"], name
        assert operation.get("description"), name
        assert operation["tags"], name
        for parameter in operation.get("parameters", ()):
            assert parameter.get("description"), (name, parameter["name"])


def test_a_summary_is_the_first_sentence_of_the_description(document):
    summaries = {name: operation["summary"] for name, operation in operations(document)}
    assert summaries["PUT /v1/maps/{map}/live"] == "Make a revision live, a newer or an older one"
    assert summaries["POST /v1/maps/{map}/builds"] == "Queue a build"
    for name, summary in summaries.items():
        assert 10 <= len(summary) <= 90, name
        assert "\n" not in summary


def test_every_answer_has_a_schema(document):
    for name, operation in operations(document):
        for status, answer in operation["responses"].items():
            assert answer["description"], (name, status)
            if status in {"101", "204", "304"}:
                assert "content" not in answer, (name, status)
                continue
            for kind, content in answer["content"].items():
                assert content["schema"], (name, status, kind)
                # What OpenAPI 3.1 has: `itemSchema` is of 3.2, and generators reject or drop it.
                assert content.keys() <= {"schema", "example", "examples"}, (name, status, kind)


def test_every_route_behind_a_key_says_how_any_request_may_be_refused(document):
    everywhere = {problem_name(kind) for kind in (*KEY, InternalError)}
    behind_a_key = [(name, it) for name, it in operations(document) if it.get("security")]
    assert len(behind_a_key) > 60
    for name, operation in behind_a_key:
        contents = [answer.get("content", {}) for answer in operation["responses"].values()]
        described = {
            problem
            for content in contents
            for problem in content.get("application/problem+json", {}).get("examples", ())
        }
        assert everywhere <= described, (name, everywhere - described)


def test_every_error_is_a_problem_with_an_example_of_each(document):
    names = {problem_name(kind): status for kind, status in STATUS.items()}
    for name, operation in operations(document):
        for status, answer in operation["responses"].items():
            if int(status) < 400 or name == "GET /readyz":
                continue
            content = answer["content"]["application/problem+json"]
            assert list(answer["content"]) == ["application/problem+json"], (name, status)
            assert content["schema"] == {"$ref": "#/components/schemas/Problem"}
            assert content["examples"]
            for problem in content["examples"]:
                assert names[problem] == int(status), (name, problem)


def test_every_route_behind_the_key_is_described_so(document):
    for name, operation in operations(document):
        if " /v1/" in name:
            assert operation["security"], name
            assert {"401", "421", "500", "503"} <= set(operation["responses"]), name
        elif name.endswith(" /metrics"):  # works without the catalog
            assert operation["security"], name
            assert {"401", "421", "500"} <= set(operation["responses"]), name
        else:
            assert "security" not in operation, name


def test_every_body_has_a_type_and_json_has_an_example(document):
    schemas = document["components"]["schemas"]
    for name, operation in operations(document):
        if "requestBody" not in operation:
            continue
        assert {"413", "415"} <= set(operation["responses"]), name
        for kind, content in operation["requestBody"]["content"].items():
            if kind == "application/json":
                schema = schemas[content["schema"]["$ref"].rpartition("/")[2]]
                assert ("example" in schema) is not ("examples" in schema), name
            else:
                assert content["schema"]["format"] == "binary", name


def test_what_a_client_may_have_already_is_described_where_it_is_honoured(client, document):
    """A map's version does not count the service's default retention, which its answer has."""
    held, described = set(), set()
    for name, operation in operations(document):
        if name.startswith("GET "):
            answers = operation["responses"]
            held |= {name} if "304" in answers else set()
            if "ETag" in answers.get("200", {}).get("headers", {}):
                described.add(name)
                what = answers["200"]["headers"]["ETag"]["description"]
                assert "of a map for `If-Match`, else for `If-None-Match`" in what
    assert described - held == {"GET /v1/maps/{map}"}
    assert held < described
    etag = {"If-None-Match": client.get("/v1/maps/campus").headers["ETag"]}
    assert client.get("/v1/maps/campus", headers=etag).status_code == 200


def test_the_body_that_the_docs_fill_in_for_a_map_removes_nothing(document):
    """Swagger UI takes the first of `examples`, and only without these `example`."""
    first, *_ = document["components"]["schemas"]["MapPatch"]["examples"]
    assert first.keys() == {"description"}


def test_no_field_has_null_as_its_default(document):
    """Generated clients fill defaults in: null would remove a map's anchor and a scan's pose."""
    for node in walk(document):
        assert not (isinstance(node, dict) and "default" in node and node["default"] is None), node
    defaults = document["components"]["schemas"]["BuildParameters"]["properties"]
    assert defaults["encoding"]["default"] == "harmonic"


def test_the_document_is_built_once_in_a_thread_and_kept_for_all_who_ask(tmp_path, monkeypatch):
    """It takes 3 s to build, 30 ms to write (950 KB): nobody else would get an answer meanwhile."""
    on_loop = []

    def built():
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            on_loop.append(False)
        else:
            on_loop.append(True)
        return {"openapi": "3.1.0"}

    with running(tmp_path / "data") as client:
        monkeypatch.setattr(client.app, "openapi", built)
        assert on_loop == []
        with ThreadPoolExecutor(4) as pool:
            answers = list(pool.map(client.get, ["/openapi.json"] * 8))
    assert on_loop == [False]
    assert {answer.content for answer in answers} == {b'{"openapi":"3.1.0"}'}


def test_a_document_that_could_not_be_built_is_built_for_the_next_request(tmp_path, monkeypatch):
    with running(tmp_path / "data") as client:
        with monkeypatch.context() as broken:
            broken.setattr(client.app, "openapi", dict.fromkeys)  # a TypeError
            assert client.get("/openapi.json").status_code == 500
        monkeypatch.setattr(client.app, "openapi", lambda: {"openapi": "3.1.0"})
        assert client.get("/openapi.json").json() == {"openapi": "3.1.0"}


def test_who_has_the_document_gets_no_other_copy(client):
    first = client.get("/openapi.json")
    for held in (first.headers["ETag"], f'W/{first.headers["ETag"]}, "other"', "*"):
        again = client.get("/openapi.json", headers={"If-None-Match": held})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["ETag"] == first.headers["ETag"]
    other = client.get("/openapi.json", headers={"If-None-Match": '"other"'})
    assert (other.status_code, other.content) == (200, first.content)


class Assets(HTMLParser):
    """Collects what a page loads."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag in {"script", "img", "iframe"} and "src" in given:
            self.found.append(given["src"])
        if tag == "link":
            self.found.append(given["href"])


def test_the_documentation_is_read_without_the_internet(client):
    assert client.get("/redoc").status_code == 404  # its script loads a logo from elsewhere
    response = client.get("/docs")
    assert response.status_code == 200
    assets = Assets()
    assets.feed(response.text)
    assert assets.found
    for asset in assets.found:
        assert re.match(r"/(?!/)", asset), asset
        assert client.get(asset).status_code == 200, asset
    # Nothing that a script in the page itself would load, either.
    assert not re.search(r"https?://", response.text)


def test_the_documentation_has_a_language_and_a_message_without_javascript(client):
    page = client.get("/docs").text
    assert '<html lang="en">' in page
    message = page.partition("<noscript>")[2].partition("</noscript>")[0]
    assert "needs JavaScript" in message
    assert 'href="/openapi.json"' in message


def test_no_summary_has_the_marks_of_code_which_the_page_would_show(document):
    summaries = [
        operation["summary"] for path in document["paths"].values() for operation in path.values()
    ]
    assert not [summary for summary in summaries if "`" in summary]
    assert "Explain the type of a problem" in summaries


def test_the_root_leads_a_person_to_the_documentation(client):
    assert client.get("/").request.url.path == "/docs"


def test_the_cursor_that_a_page_returns_is_of_the_type_that_the_next_request_takes(document):
    """A generated client passes it on as it is."""
    schemas, pages = document["components"]["schemas"], 0
    for name, operation in operations(document):
        answers = operation["responses"].get("200", {}).get("content", {})
        reference = answers.get("application/json", {}).get("schema", {}).get("$ref", "")
        fields = schemas.get(reference.rpartition("/")[2], {}).get("properties", {})
        for parameter in operation.get("parameters", ()):
            if (cursor := fields.get(f"next_{parameter['name']}")) is not None:
                types = {kind["type"] for kind in cursor["anyOf"]} - {"null"}
                assert types == {parameter["schema"]["type"]}, (name, parameter["name"])
                pages += 1
    assert pages > 10
