"""A map as a graph: which segments meet, and which share an edge."""

import numpy as np
import pytest

from core.errors import InvalidMap
from core.scans.trajectory import Trajectory
from core.topology import Entry, Topology, segment_ends
from tests.support.samples import sample_map, two_drives

AHEAD, BACK = True, False


def joined() -> Topology:
    """A street driven there (0, 1) and back (2, 3), and on from its beginning (4)."""
    return Topology(
        node_scan=np.array([0, 5, 9, 25]),
        edge_nodes=np.array([[0, 1], [1, 2], [0, 3]]),
        edge_length_m=np.array([5.0, 4.0, 7.0]),
        edge_scans=np.array([5, 4, 7]),
        edge_of_segment=np.array([0, 1, 1, 0, 2]),
        segment_reversed=np.array([0, 0, 1, 1, 0]),
    )


def test_a_segment_of_a_plain_graph_leads_to_the_next_one_of_its_drive():
    graph = sample_map(24, 8, drives=2)[0].topology
    assert graph.is_plain
    assert graph.segment_nodes.tolist() == graph.edge_nodes.tolist()
    assert graph.segments_at(0) == (Entry(0, AHEAD),)
    assert graph.segments_at(1) == (Entry(0, BACK), Entry(1, AHEAD))
    assert graph.neighbours(0) == (Entry(1, AHEAD),)
    assert graph.neighbours(1, forward=False) == (Entry(0, BACK),)
    assert graph.neighbours(2) == ()
    assert graph.neighbours(3, forward=False) == ()


def test_segments_of_one_edge_meet_at_its_nodes_in_their_own_direction():
    graph = joined()
    assert not graph.is_plain
    assert graph.segment_nodes.tolist() == [[0, 1], [1, 2], [2, 1], [1, 0], [0, 3]]
    assert graph.segments_at(1) == (
        Entry(0, BACK), Entry(1, AHEAD), Entry(2, BACK), Entry(3, AHEAD)
    )  # fmt: skip
    assert graph.neighbours(0) == (Entry(1, AHEAD), Entry(2, BACK))
    assert graph.neighbours(2) == (Entry(0, BACK), Entry(3, AHEAD))
    assert graph.neighbours(3) == (Entry(4, AHEAD),)
    assert graph.neighbours(1) == ()


def test_a_round_leads_into_itself_again():
    graph = Topology(np.array([0, 0]), np.array([[0, 0]]), np.array([9.0]), np.array([9]))
    assert graph.segments_at(0) == (Entry(0, BACK), Entry(0, AHEAD))
    assert graph.neighbours(0) == (Entry(0, AHEAD),)
    assert graph.neighbours(0, forward=False) == (Entry(0, BACK),)


@pytest.mark.parametrize("segment", [-1, 5])
def test_an_unknown_segment_or_node_is_an_index_error(segment):
    with pytest.raises(IndexError, match=f"segment {segment} of a map of 5"):
        joined().neighbours(segment)
    with pytest.raises(IndexError, match="node 4 of a graph of 4"):
        joined().segments_at(4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"edge_scans": [5, 4]}, r"edge_scans has shape \(2,\), wanted \(3,\)"),
        ({"edge_scans": [5, 4, -1]}, "edge_scans has negative"),
        ({"edge_of_segment": [0, 1, 1, 0]}, r"segment_reversed has shape \(5,\), wanted \(4,\)"),
        ({"edge_of_segment": [0, 1, 1, 0, 0]}, "does not name every edge"),
        ({"edge_of_segment": [1, 0, 0, 1, 2]}, "in the order of segments"),
        ({"edge_of_segment": [0, 1, 1, 0, 3]}, "does not name every edge"),
        ({"segment_reversed": [0, 1, 1, 1, 0]}, "first segment of an edge runs along it backwards"),
    ],
)
def test_inconsistent_edges_and_segments_are_rejected(changes, message):
    graph = joined()
    parts = {
        "node_scan": graph.node_scan,
        "edge_nodes": graph.edge_nodes,
        "edge_length_m": graph.edge_length_m,
        "edge_scans": graph.edge_scans,
        "edge_of_segment": graph.edge_of_segment,
        "segment_reversed": graph.segment_reversed,
    }
    with pytest.raises(InvalidMap, match=message):
        Topology(**{**parts, **{name: np.array(value) for name, value in changes.items()}})


def test_a_segment_ends_where_the_next_one_of_its_drive_begins():
    poses = np.full((6, 7), np.nan)
    one = Trajectory(("a", "b"), np.array([0, 4, 6]), np.r_[0:4, 0:2], np.zeros(6), poses)
    ends = segment_ends(one.drive_start, np.array([0, 2, 4, 6]))
    assert ends.tolist() == [[0, 2], [2, 3], [4, 5]]
    graph = Topology.of_segments(one, np.array([0, 2, 4, 6]))
    assert graph.node_scan[graph.segment_nodes].tolist() == ends.tolist()


def test_nodes_are_where_segments_meet_and_at_a_drives_last_scan():
    graph = Topology.of_segments(two_drives(), np.array([0, 2, 4, 5]))
    assert graph.node_scan.tolist() == [0, 1, 2, 4, 4]
    assert graph.edge_nodes.tolist() == [[0, 1], [2, 3], [3, 4]]
    assert graph.edge_length_m.tolist() == [1.0, 2.0, 0.0]
    assert graph.edge_scans.tolist() == [1, 2, 0]


def test_without_poses_no_edge_has_a_length():
    unknown = two_drives(poses=np.full((5, 7), np.nan))
    lengths_m = Topology.of_segments(unknown, np.array([0, 2, 4, 5])).edge_length_m
    assert np.isnan(lengths_m).all()


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (([0, 4], [[0, 2]], [1.0]), "names a node that does not exist"),
        (([0, 4], [[-1, 1]], [1.0]), "names a node that does not exist"),
        (([0, 4], [[0, 1, 1]], [1.0]), r"edge_nodes has shape \(1, 3\), wanted \(1, 2\)"),
        (([[0, 4]], [[0, 0]], [1.0]), "node_scan has shape"),
        (([0, 4], [[0, 1]], [[1.0, 2.0]]), "edge_length_m has shape"),
        (([0, 4], [[0, 1]], [-1.0]), "negative"),
        (([0, 4], [[0, 1]], [np.inf]), "infinite"),
    ],
)
def test_an_impossible_graph_is_rejected(parts, message):
    with pytest.raises(InvalidMap, match=message):
        Topology(*parts)
