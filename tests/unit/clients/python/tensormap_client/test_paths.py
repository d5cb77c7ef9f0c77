"""Paths of resources: a name is one segment, or no request is sent."""

from collections.abc import Callable
from typing import Any

import httpx2
import pytest
from tensormap_client import Admin, InvalidArgument, Locator, Mapper

HERE = "http://maps.example"

OF_ONE_NAME: dict[str, Callable[[Admin, str], Any]] = {
    "delete_map": lambda admin, name: admin.delete_map(name),
    "delete_drive": lambda admin, name: admin.delete_drive("campus", name),
    "revision": lambda admin, name: admin.revision("campus", name),
    "comparison": lambda admin, name: admin.comparison("campus", name),
    "delete_revision": lambda admin, name: admin.delete_revision("campus", name),
    "revoke_key": lambda admin, name: admin.revoke_key(name),
    "cancel": lambda admin, name: admin.cancel(name),
    "restore": lambda admin, name: admin.restore(name),
    "purge": lambda admin, name: admin.purge(name),
    "delete_basis": lambda admin, name: admin.delete_basis(name),
    "delete_capture": lambda admin, name: admin.delete_capture("campus", "monday", name),
    "close_drive": lambda admin, name: admin.close_drive("campus", name),
    "key": lambda admin, name: admin.key(name),
}


@pytest.mark.parametrize("name", ["", ".", "..", "../maps/campus", "a/b"])
@pytest.mark.parametrize("method", OF_ONE_NAME)
def test_a_name_that_would_lead_to_another_resource_is_rejected_and_nothing_is_sent(method, name):
    sent: list[str] = []

    def service(request: httpx2.Request) -> httpx2.Response:
        sent.append(f"{request.method} {request.url.path}")
        return httpx2.Response(204)

    with (
        Admin(HERE, connections=httpx2.MockTransport(service)) as admin,
        pytest.raises(InvalidArgument, match="wanted a name"),
    ):
        OF_ONE_NAME[method](admin, name)
    assert sent == []


def test_neither_a_mapper_nor_a_locator_is_made_for_such_a_name():
    with pytest.raises(InvalidArgument, match="is no slug"):
        Mapper(HERE, None, "..")
    with pytest.raises(InvalidArgument, match="wanted a name"):
        Locator(HERE, None, "campus/basis")


@pytest.mark.parametrize("name", ["a b", "ä", "a?b", "a#b", "%2e%2e", "a\\b"])
def test_all_other_characters_are_those_of_one_segment(name):
    paths: list[bytes] = []

    def service(request: httpx2.Request) -> httpx2.Response:
        paths.append(request.url.raw_path)
        return httpx2.Response(204)

    with Admin(HERE, connections=httpx2.MockTransport(service)) as admin:
        admin.delete_revision("campus", name)
    [path] = paths
    segment = path.removeprefix(b"/v1/maps/campus/revisions/")
    assert httpx2.URL(HERE).copy_with(raw_path=b"/" + segment).path == f"/{name}"
    assert not {*b"/?#"} & {*segment}
