"""The service under a path of a host that it shares with others."""

import re

import pytest
from starlette.testclient import WebSocketDenialResponse

from app.main import create_app
from app.settings import Settings
from tests.support.access import ADMIN, ADMIN_KEY
from tests.support.service import copy_of, problem_of, running

PREFIX = "/lidar/maps"
ON_THE_WAY = pytest.mark.parametrize("sent", [PREFIX, ""], ids=["passed on", "removed"])


@pytest.fixture(scope="module")
def behind(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shared")
    with running(folder, admin_key=ADMIN_KEY, path_prefix=PREFIX) as client:
        yield client


@ON_THE_WAY
def test_a_location_leads_back_to_the_service(behind, sent):
    map_slug = f"map{len(sent)}"
    created = behind.post(f"{sent}/v1/maps", headers=ADMIN, json={"map": map_slug})
    assert created.status_code == 201
    assert created.headers["Location"] == f"{PREFIX}/v1/maps/{map_slug}"
    found = behind.get(created.headers["Location"], headers=ADMIN)
    assert found.json() == created.json()


@ON_THE_WAY
def test_the_page_of_the_api_finds_its_document_and_its_files(behind, sent):
    home = behind.get(sent or "/", follow_redirects=False)
    assert home.headers["Location"] == f"{PREFIX}/docs"
    page = behind.get(f"{sent}/docs").text
    assert f"url: '{PREFIX}/openapi.json'" in page
    files = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert len(files) >= 3
    for file in [f"{PREFIX}/openapi.json", *files]:
        assert file.startswith(PREFIX)
        assert behind.get(file).status_code == 200
        assert behind.get(file.removeprefix(PREFIX)).status_code == 200
    assert behind.get(f"{PREFIX}/openapi.json").json()["servers"] == [{"url": PREFIX}]


@ON_THE_WAY
def test_a_key_is_asked_for_as_without_a_prefix(behind, sent):
    assert problem_of(behind.get(f"{sent}/v1/maps")) == (401, "key-needed")
    assert behind.get(f"{sent}/metrics").status_code == 401
    assert behind.get(f"{sent}/livez").status_code == 200


@pytest.mark.parametrize("path", [PREFIX * 2, f"{PREFIX}x", f"/{PREFIX}", "/lidar"])
def test_no_other_path_leads_to_the_service(behind, path):
    assert behind.get(f"{path}/v1/maps", headers=ADMIN).status_code == 404


def test_a_track_is_streamed_below_the_prefix(tmp_path, built):
    data_dir = copy_of(built.data_dir, tmp_path / "data")
    with running(data_dir, admin_key=ADMIN_KEY, path_prefix=PREFIX) as client:
        track = client.post(f"{PREFIX}/v1/maps/campus/tracks", headers=ADMIN).headers["Location"]
        with client.websocket_connect(f"{track}/stream", headers=ADMIN) as stream:
            stream.send_text("{}")
            assert stream.receive_json()["type"] == "/problems/invalid-request"
        with (
            pytest.raises(WebSocketDenialResponse) as refused,
            client.websocket_connect(f"{track}/stream"),
        ):
            pass
        assert refused.value.status_code == 401


@pytest.mark.parametrize("given", ["lidar", "/", "/lidar/", "//lidar", "/a b", "/..", "/ä", "/a?b"])
def test_what_is_no_path_is_rejected_at_the_start(given):
    with pytest.raises(ValueError, match="wanted a path, for example `/tensormap`"):
        Settings(path_prefix=given)


def test_a_prefix_does_not_hide_a_path_of_the_service(tmp_path):
    app = create_app(Settings(data_dir=tmp_path))
    begin = {path.split("/")[1] for route in app.routes if (path := getattr(route, "path", None))}
    own = begin - {"", "{path:path}"}
    assert own >= {"v1", "docs", "livez"}
    for name in own:
        for given in (f"/{name}", f"/{name}/more"):
            with pytest.raises(ValueError, match="is a path of the service"):
                Settings(path_prefix=given)
