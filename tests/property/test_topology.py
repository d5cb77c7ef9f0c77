"""Laws of the graph: segments that meet are joined, others are not."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from core.arrays import FloatArray, IntArray
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.segmentation.turns import cut_at_turns
from core.topology import Topology, cut_at_meetings, join_segments, segment_ends
from tests.support.samples import trajectory

steps_m = st.floats(0.8, 4.0)
lengths = st.integers(12, 80)  # scans in a segment
few = settings(max_examples=40)  # each has a drive of hundreds of scans


def along(corners_m: list[tuple[float, float]], step_m: float) -> FloatArray:
    """Return `(K, 7)` poses along a line through corners, in the direction of travel."""
    corners = np.array(corners_m, dtype=np.float64)
    arc_m = np.cumsum([0.0, *np.linalg.norm(np.diff(corners, axis=0), axis=1)])
    at_m = np.append(np.arange(0.0, arc_m[-1], step_m), arc_m[-1])
    rows = np.zeros((len(at_m), 7))
    rows[:, 0], rows[:, 1] = (np.interp(at_m, arc_m, axis) for axis in corners.T)
    side = np.searchsorted(arc_m, at_m, side="left").clip(1, len(corners) - 1) - 1
    heading = np.arctan2(*(np.diff(corners, axis=0)[side].T[::-1]))
    rows[:, 5], rows[:, 6] = np.sin(heading / 2), np.cos(heading / 2)
    return rows


def graph(mapped: Trajectory, length: int) -> tuple[Topology, IntArray]:
    cuts = cut_at_turns(mapped, cut_drives(mapped.drive_start, length))
    cuts = cut_at_meetings(mapped, cuts)
    return join_segments(mapped, cuts), cuts


def parts_of(found: Topology) -> int:
    """Return the number of connected parts."""
    part = list(range(len(found.node_scan)))
    for first, last in found.edge_nodes.tolist():
        old, new = part[first], part[last]
        part = [new if one == old else one for one in part]
    return len(set(part))


@st.composite
def wanderings(draw: st.DrawFn) -> FloatArray:
    """Draw a drive through a grid of streets 60 m apart, which crosses and repeats itself."""
    column, row = 0, 0
    corners = [(0.0, 0.0)]
    for direction in draw(st.lists(st.sampled_from("NESW"), min_size=1, max_size=14)):
        column += {"E": 1, "W": -1}.get(direction, 0)
        row += {"N": 1, "S": -1}.get(direction, 0)
        corners.append((60.0 * column, 60.0 * row))
    return along(corners, draw(steps_m))


@few
@given(wanderings(), lengths)
def test_the_graph_of_one_drive_is_connected_and_has_every_segment(poses, length):
    mapped = trajectory(poses)
    found, cuts = graph(mapped, length)
    assert parts_of(found) == 1
    assert len(found.edge_of_segment) == len(cuts) - 1
    assert (cuts[0], cuts[-1]) == (0, len(poses))
    assert (np.diff(cuts) >= 1).all()
    nodes = found.segment_nodes
    assert nodes[1:, 0].tolist() == nodes[:-1, 1].tolist()  # a segment begins where one ended


@few
@given(wanderings(), lengths)
def test_no_street_of_a_grid_is_in_the_graph_twice(poses, length):
    found, _ = graph(trajectory(poses), length)
    corners = np.round(poses[:, :2] / 60.0, 9)
    passed = {
        frozenset([tuple(np.floor(middle).astype(int)), tuple(np.ceil(middle).astype(int))])
        for middle in (corners[1:] + corners[:-1]) / 2.0
        if (np.ceil(middle) - np.floor(middle)).sum() == 1
    }
    streets_m = 60.0 * len(passed)
    assert np.nansum(found.edge_length_m) <= streets_m + 15.0 * len(passed)


@few
@given(wanderings(), lengths)
def test_a_second_cut_where_drives_meet_changes_nothing(poses, length):
    mapped = trajectory(poses)
    _, cuts = graph(mapped, length)
    assert cut_at_meetings(mapped, cuts).tolist() == cuts.tolist()


@few
@given(wanderings(), lengths, st.floats(-3.0, 3.0), st.floats(-1e4, 1e4))
def test_the_graph_does_not_depend_on_the_origin_of_the_world_frame(poses, length, angle, shift_m):
    poses[:, :2] += np.random.default_rng(0).normal(scale=0.01, size=(len(poses), 2))  # no ties
    moved = poses.copy()
    c, s = np.cos(angle), np.sin(angle)
    moved[:, :2] = poses[:, :2] @ np.array([[c, s], [-s, c]]) + shift_m
    (here, cuts), (there, moved_cuts) = graph(trajectory(poses), length), graph(
        trajectory(moved), length
    )  # fmt: skip
    assert np.abs(cuts - moved_cuts).max() <= 1 if len(cuts) == len(moved_cuts) else False
    assert here.edge_of_segment.tolist() == there.edge_of_segment.tolist()
    assert here.edge_nodes.tolist() == there.edge_nodes.tolist()
    np.testing.assert_allclose(here.edge_length_m.sum(), there.edge_length_m.sum(), rtol=0.1)


@few
@given(wanderings(), lengths)
def test_the_graph_depends_on_no_names_times_or_headings(poses, length):
    mapped = trajectory(poses)
    same_heading = poses.copy()
    same_heading[:, 3:] = [0.0, 0.0, 0.0, 1.0]
    other = Trajectory.of_drive(
        "x", np.full(len(poses), np.nan), same_heading, np.arange(len(poses)) * 3
    )
    (here, cuts), (there, other_cuts) = graph(mapped, length), graph(other, length)
    assert cuts.tolist() == other_cuts.tolist()
    for name, array in here.arrays().items():
        np.testing.assert_array_equal(array, there.arrays()[name])


@few
@given(st.floats(15.0, 80.0), st.floats(0.0, 6.0), steps_m, lengths, st.sampled_from([-1.0, 1.0]))
def test_a_round_that_is_driven_twice_is_in_the_graph_once(radius_m, begin, step_m, length, turn):
    angle = turn * (begin + np.linspace(0.0, 4.0 * np.pi, 400))
    twice = along(
        list(zip(radius_m * np.cos(angle), radius_m * np.sin(angle), strict=True)), step_m
    )
    mapped = trajectory(twice)
    found, _ = graph(mapped, length)
    assert found.edge_length_m.sum() <= mapped.path_m(0, len(mapped) - 1) / 2.0 + 15.0


@few
@given(steps_m, lengths, st.integers(80, 400))
def test_there_and_back_gives_half_the_edges(step_m, length, far_m):
    there = along([(0.0, 0.0), (float(far_m), 0.0)], step_m)
    alone, _ = graph(trajectory(there), length)
    for mapped in (
        trajectory(there, there[::-1]),
        trajectory(there, there[::-1] + np.array([0, 4.0, 0, 0, 0, 0, 0])),
    ):
        found, _ = graph(mapped, length)
        assert 2 * found.edges == len(found.edge_of_segment)
        assert found.edges == alone.edges
        assert found.edge_length_m.tolist() == alone.edge_length_m.tolist()
        half = found.edges
        assert found.edge_of_segment.tolist() == [*range(half), *range(half)[::-1]]
        assert found.segment_reversed.tolist() == [False] * half + [True] * half


@few
@given(steps_m, lengths, st.integers(80, 400))
@example(1.0, 12, 250)  # it turns exactly as far beyond a cut as one may be from a meeting place
def test_a_drive_that_turns_round_comes_back_along_the_same_edges(step_m, length, far_m):
    found, _ = graph(trajectory(along([(0, 0), (far_m, 0), (0, 0)], step_m)), length)
    assert 2 * found.edges == len(found.edge_of_segment)
    # A line is thinned to steps of a metre, so that a stationary vehicle does not jitter; and a
    # metre of turning on the spot is taken for jitter.
    assert abs(found.edge_length_m.sum() - far_m) <= 2.0 * step_m + 2.0
    assert found.segment_reversed.sum() == found.edges
    assert found.segment_nodes[0, 0] == found.segment_nodes[-1, 1] == 0


@few
@given(steps_m, lengths, st.floats(35.0, 145.0), st.integers(60, 200))
def test_streets_that_cross_share_a_node_and_no_edge(step_m, length, degrees, half_m):
    # A figure of eight: two streets that cross at the origin, their ends far apart.
    c, s = np.cos(np.radians(degrees)) * half_m, np.sin(np.radians(degrees)) * half_m
    eight = along([(-half_m, 0), (half_m, 0), (half_m, 300), (c, 300), (c, s), (-c, -s)], step_m)
    mapped = trajectory(eight)
    plain = Topology.of_segments(mapped, cut_drives(mapped.drive_start, length))
    found, _ = graph(mapped, length)
    assert found.edges == len(found.edge_of_segment) >= plain.edges
    nodes, times = np.unique(found.segment_nodes, return_counts=True)
    crossings = nodes[times == 4]
    places_m = eight[found.node_scan[crossings], :2]
    assert (np.linalg.norm(places_m, axis=1) <= 10.0 + step_m).any()
    np.testing.assert_allclose(
        found.edge_length_m.sum(), np.linalg.norm(np.diff(eight[:, :2], axis=0), axis=1).sum()
    )


@few
@given(steps_m, lengths, st.floats(-24.0, 10.0), st.floats(-5.0, 5.0), st.booleans())
def test_a_drive_that_goes_on_where_another_ended_is_joined_to_it(
    step_m, length, gap_m, aside_m, later_first
):
    ended = along([(0, 0), (150, 0)], step_m)
    goes_on = along([(150 + gap_m, aside_m), (300, aside_m)], step_m)
    drives = [goes_on, ended] if later_first else [ended, goes_on]
    found, cuts = graph(trajectory(*drives), length)
    assert parts_of(found) == 1
    drive = np.searchsorted(np.cumsum([len(d) for d in drives]), cuts[:-1], side="right")
    last = int(np.flatnonzero(drive == int(later_first))[-1])
    assert any(drive[entry.segment] != drive[last] for entry in found.neighbours(last))


def test_drives_along_one_short_street_share_nodes_and_no_edge():
    short = along([(0, 0), (20, 0)], 1.0)
    found, _ = graph(trajectory(short, short), 100)
    assert (found.edges, len(found.node_scan)) == (2, 2)
    assert not found.is_plain


@few
@given(steps_m, lengths, st.floats(-10.0, 24.0))
def test_a_round_trip_is_joined_where_it_began(step_m, length, further_m):
    corners = [(0, 0), (100, 0), (100, 100), (-60, 100), (-60, 0), (further_m, 1.0)]
    found, cuts = graph(trajectory(along(corners, step_m)), length)
    goes_on = [entry for entry in found.neighbours(len(cuts) - 2) if entry.forward]
    assert any(cuts[entry.segment] * step_m <= 40.0 for entry in goes_on)


@few
@given(steps_m, lengths, st.sampled_from(["across", "above", "beside", "too far"]))
def test_a_drive_that_ends_near_another_street_is_not_joined_to_it(step_m, length, how):
    ended = along([(0, 0), (150, 0)], step_m)
    other = {
        "across": along([(155, 5), (155, 150)], step_m),
        "above": along([(152, 0), (300, 0)], step_m) + np.array([0, 0, 3.0, 0, 0, 0, 0]),
        "beside": along([(152, 9), (300, 9)], step_m),
        "too far": along([(166, 0), (300, 0)], step_m),
    }[how]
    assert graph(trajectory(ended, other), length)[0].is_plain


@few
@given(steps_m, lengths)
def test_a_bridge_is_no_crossing(step_m, length):
    over = along([(-100, 0), (100, 0), (100, 100), (0, 100), (0, -100)], step_m)
    over[:, 2] = np.interp(np.arange(len(over)), [0, len(over) * 0.4, len(over) - 1], [0, 5, 5])
    found, _ = graph(trajectory(over), length)
    assert found.is_plain


@few
@given(steps_m, lengths, st.floats(9.0, 50.0))
def test_streets_beside_one_another_stay_two(step_m, length, apart_m):
    one = along([(0, 0), (200, 0)], step_m)
    mapped = trajectory(one, one + np.array([0, apart_m, 0, 0, 0, 0, 0]))
    assert graph(mapped, length)[0].is_plain


@few
@given(wanderings(), lengths)
def test_without_poses_nothing_is_cut_and_nothing_joined(poses, length):
    mapped = trajectory(np.full_like(poses, np.nan))
    found, cuts = graph(mapped, length)
    assert found.is_plain
    assert cuts.tolist() == cut_drives(mapped.drive_start, length).tolist()


@few
@given(wanderings(), lengths, st.data())
def test_what_was_driven_once_is_cut_where_it_was_and_lengths_are_those_of_paths(
    poses, length, data
):
    unknown = data.draw(st.lists(st.integers(0, len(poses) - 1), max_size=3))
    turns_back = int((np.abs(np.sum(poses[:-1, 5:] * poses[1:, 5:], axis=1)) < 1e-9).sum())
    poses = poses.copy()
    poses[unknown] = np.nan
    mapped = trajectory(poses)
    found, cuts = graph(mapped, length)
    ends = segment_ends(mapped.drive_start, cuts)
    for edge in range(found.edges):
        first = int(np.flatnonzero(found.edge_of_segment == edge)[0])
        a, b = ends[first].tolist()
        assert found.edge_scans[edge] == b - a
        steps_m = np.diff(poses[a : b + 1, :3], axis=0)
        driven_m = np.linalg.norm(steps_m, axis=1).sum()
        if np.isnan(driven_m):
            assert np.isnan(found.edge_length_m[edge])
            continue
        # Where these drives turn back on the spot, as no vehicle does, less than a metre there and
        # as much back is taken for jitter.
        assert driven_m - 2 * turns_back - 1e-6 <= found.edge_length_m[edge] <= driven_m + 1e-6


@pytest.mark.parametrize("drives", [1, 2, 5])
def test_a_street_driven_again_adds_no_edge_however_often(drives):
    loop = along([(0, 0), (150, 0), (150, 90), (0, 90), (0, 0)], 1.5)
    once, _ = graph(trajectory(loop), 40)
    found, _ = graph(trajectory(*[loop + 0.3 * i * np.eye(7)[1] for i in range(drives)]), 40)
    assert found.edges == once.edges
    assert len(found.edge_of_segment) == drives * once.edges
    assert parts_of(found) == 1
