"""Over HTTP: unequal segments, and drives that meet in one graph.

These do not depend on the encoding: builds are of the paper's, whose images `own` has already.
"""

import numpy as np

from core.scans.pose import Pose
from core.scans.scan import Scan
from tests.support.recording import Recording, recording
from tests.support.service import problem_of, upload, wait_for


def driven_back(there: Recording) -> Recording:
    """Return the same places in the opposite order, the heading reversed, at the same times."""
    reversed_scans = []
    for scan, timed in zip(there.scans[::-1], there.scans, strict=True):
        assert scan.pose is not None
        x, y, z, _, _, qz, qw = scan.pose.as_tuple()
        pose = Pose(x, y, z, 0.0, 0.0, qw, -qz)
        reversed_scans.append(
            Scan(scan.points_m * np.array([-1, -1, 1], np.float32), timed.timestamp_s, pose)
        )
    return Recording(tuple(reversed_scans))


def build(client, **parameters):
    job = client.post("/v1/maps/campus/builds", json=parameters).json()["job"]
    ended = wait_for(client, job)
    assert ended["state"] == "done", ended
    return client.get("/v1/maps/campus/topology", params={"revision": ended["revision"]}).json()


def test_unequal_segments_are_chosen_for_a_build_and_shown_by_its_revision(own):
    graph = build(own, segmentation="unequal", segments=3, encoding="paper")
    [revision] = [
        item
        for item in own.get("/v1/maps/campus/revisions").json()["items"]
        if item["revision"] == graph["revision"]
    ]
    assert revision["parameters"]["segmentation"] == "unequal"
    assert sum(edge["scans"] for edge in graph["edges"]) == len(recording()) - 1
    basis = own.get("/v1/maps/campus/basis", params={"revision": graph["revision"]}).json()
    assert basis["parameters"]["segmentation"] == "unequal"
    assert len(basis["segments"]) == revision["segments"]


def test_segments_are_fixed_by_default(own):
    graph = build(own, segments=3, encoding="paper")
    items = own.get("/v1/maps/campus/revisions").json()["items"]
    assert {item["parameters"]["segmentation"] for item in items} == {"fixed"}
    assert [edge["segment"] for edge in graph["edges"]] == [0, 1, 2]


def test_another_segmentation_is_refused(own):
    refused = own.post("/v1/maps/campus/builds", json={"segmentation": "random"})
    assert problem_of(refused) == (422, "invalid-request")
    assert "segmentation" in refused.json()["detail"]


def test_a_drive_back_along_the_same_streets_adds_segments_and_no_edge(own):
    alone = build(own, segments=3, encoding="paper")
    upload(own, "back", driven_back(recording()))
    both = build(own, segments=3, encoding="paper", drives=["monday", "back"])
    assert len(both["nodes"]) == len(alone["nodes"])
    assert [edge["length_m"] for edge in both["edges"]] == [
        edge["length_m"] for edge in alone["edges"]
    ]
    along = [[(s["segment"], s["reversed"]) for s in edge["segments"]] for edge in both["edges"]]
    assert along == [[(0, False), (5, True)], [(1, False), (4, True)], [(2, False), (3, True)]]
