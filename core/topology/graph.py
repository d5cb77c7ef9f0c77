"""The map as a graph: nodes where segments end, edges along segments (paper, sec. 1)."""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import BoolArray, FloatArray, IntArray, freeze, frozen
from core.errors import InvalidMap
from core.scans.trajectory import Trajectory

JOINED = ("edge_scans", "edge_of_segment", "segment_reversed")
"""Arrays that only a joined graph has in its file: all three or none."""
_LONGEST_M = 1e15  # more than any path of valid poses
_MOST_SCANS = 2**53  # every JSON parser reads them exactly


@dataclass(frozen=True, order=True)
class Entry:
    """A segment, and the end where it is entered.

    Attributes:
        segment: The segment's number.
        forward: Entered at its first scan and driven as it was recorded; else from its last scan
            backwards.
    """

    segment: int
    forward: bool


@dataclass(frozen=True, eq=False)
class Topology:
    """Nodes, edges, and which segments run along an edge.

    In a street that was driven once, an edge is a segment. Segments of a street that was driven
    again, in either direction, share an edge; its length and direction are those of the first.

    Attributes:
        node_scan: `(N,)` the row of the first scan at the node.
        edge_nodes: `(E, 2)` the nodes where an edge begins and ends.
        edge_length_m: `(E,)` length of the path in metres, NaN where a pose on it is unknown.
        edge_scans: `(E,)` length in scans, from node to node; from `node_scan` by default.
        edge_of_segment: `(L,)` the edge along which each segment runs; edge `l` is segment `l` by
            default.
        segment_reversed: `(L,)` whether it runs from the edge's second node to its first; none by
            default.

    Raises:
        InvalidMap: If the arrays are inconsistent.
    """

    node_scan: IntArray
    edge_nodes: IntArray
    edge_length_m: FloatArray
    edge_scans: IntArray = None  # type: ignore[assignment]  # set in `__post_init__`
    edge_of_segment: IntArray = None  # type: ignore[assignment]
    segment_reversed: BoolArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        freeze(self, node_scan=np.int64, edge_nodes=np.int64, edge_length_m=np.float64)
        self._require_edges()
        self._set_default("edge_scans", self._path_scans(), np.int64)
        self._set_default("edge_of_segment", np.arange(self.edges), np.int64)
        self._set_default("segment_reversed", np.zeros(len(self.edge_of_segment)), np.bool_)
        self._require_segments()

    def _set_default(self, name: str, default: NDArray[Any], dtype: Any) -> None:  # noqa: ANN401
        given = getattr(self, name)
        object.__setattr__(self, name, frozen(default if given is None else given, dtype))

    def _require_shape(self, name: str, *shape: int) -> None:
        if (found := getattr(self, name).shape) != shape:
            raise InvalidMap(f"{name} has shape {found}, wanted {shape}")

    def _require_edges(self) -> None:
        nodes, lengths_m = len(self.node_scan), self.edge_length_m
        self._require_shape("node_scan", nodes)
        self._require_shape("edge_length_m", self.edges)
        self._require_shape("edge_nodes", self.edges, 2)
        if (lengths_m < 0).any() or (lengths_m > _LONGEST_M).any():
            raise InvalidMap(
                f"edge_length_m has negative or infinite numbers, or more than {_LONGEST_M:g}"
            )
        if (self.edge_nodes < 0).any() or (self.edge_nodes >= nodes).any():
            raise InvalidMap("edge_nodes names a node that does not exist")

    def _require_segments(self) -> None:
        of_segment = self.edge_of_segment
        self._require_shape("edge_scans", self.edges)
        self._require_shape("edge_of_segment", len(of_segment))
        self._require_shape("segment_reversed", len(of_segment))
        edges, first = np.unique(of_segment, return_index=True)
        if not np.array_equal(edges, np.arange(self.edges)) or (np.diff(first) < 1).any():
            raise InvalidMap("edge_of_segment does not name every edge, in the order of segments")
        if self.segment_reversed[first].any():
            raise InvalidMap("the first segment of an edge runs along it backwards")
        if not self.is_plain and (self.edge_scans < 0).any():
            raise InvalidMap("edge_scans has negative numbers")
        if (self.edge_scans >= _MOST_SCANS).any():
            raise InvalidMap(f"edge_scans has numbers of {_MOST_SCANS} or more")

    def _path_scans(self) -> IntArray:
        return np.asarray(np.diff(self.node_scan[self.edge_nodes], axis=1)[:, 0])

    @property
    def edges(self) -> int:
        """E, the number of edges."""
        return len(self.edge_length_m)

    @cached_property
    def is_plain(self) -> bool:
        """Whether nothing is joined: edge `l` is segment `l`, and paths share no node."""
        before, after = self.edge_nodes[:-1, :, None], self.edge_nodes[1:, None]
        paths = 1 + int((before != after).all(axis=(1, 2)).sum())
        return (
            len(self.edge_of_segment) == self.edges
            and len(self.node_scan) == self.edges + paths
            and not self.segment_reversed.any()
            and np.array_equal(self.edge_scans, self._path_scans())
        )

    @cached_property
    def segment_nodes(self) -> IntArray:
        """The nodes where each segment begins and ends, in its own direction, `(L, 2)`."""
        nodes = self.edge_nodes[self.edge_of_segment]
        turned = np.where(self.segment_reversed[:, None], nodes[:, ::-1], nodes)
        return np.asarray(frozen(turned, np.int64))

    def segments_at(self, node: int) -> tuple[Entry, ...]:
        """Return every segment that can be entered at a node, in order.

        A segment that begins and ends there is returned twice.

        Raises:
            IndexError: If there is no such node.
        """
        if not 0 <= node < len(self.node_scan):
            raise IndexError(f"node {node} of a graph of {len(self.node_scan)}")
        return self._entries.get(node, ())

    def neighbours(self, segment: int, *, forward: bool = True) -> tuple[Entry, ...]:
        """Return the segments that a vehicle may enter at the end of a segment.

        Args:
            segment: The segment it drives along.
            forward: Whether it drives in the direction of the recording, to the last scan; else to
                the first.

        Returns:
            The segments at that node, in order, without those back along the same edge.

        Raises:
            IndexError: If there is no such segment.
        """
        if not 0 <= segment < len(self.edge_of_segment):
            raise IndexError(f"segment {segment} of a map of {len(self.edge_of_segment)}")
        edge, along = self.edge_of_segment[segment], forward != self.segment_reversed[segment]
        return tuple(
            entry
            for entry in self.segments_at(int(self.segment_nodes[segment, int(forward)]))
            if self.edge_of_segment[entry.segment] != edge
            or (entry.forward != self.segment_reversed[entry.segment]) == along
        )

    @cached_property
    def _entries(self) -> dict[int, tuple[Entry, ...]]:
        entries: dict[int, list[Entry]] = defaultdict(list)
        for segment, (first, last) in enumerate(self.segment_nodes.tolist()):
            entries[first].append(Entry(segment, forward=True))
            entries[last].append(Entry(segment, forward=False))
        return {node: tuple(sorted(found)) for node, found in entries.items()}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array by its name in the file; a plain graph has three."""
        arrays: dict[str, NDArray[Any]] = {
            "node_scan": self.node_scan,
            "edge_nodes": self.edge_nodes,
            "edge_length_m": self.edge_length_m,
        }
        if not self.is_plain:
            arrays["edge_scans"] = self.edge_scans
            arrays["edge_of_segment"] = self.edge_of_segment
            arrays["segment_reversed"] = self.segment_reversed.astype(np.int8)
        return arrays

    @classmethod
    def of_segments(cls, trajectory: Trajectory, segment_start: IntArray) -> "Topology":
        """Return the graph that joins each segment to the next one of its drive only.

        A node is at each segment's first scan, which is the end of the one before, and at each
        drive's last scan.
        """
        node_scan: list[int] = []
        edge_nodes: list[tuple[int, int]] = []
        lengths_m: list[float] = []
        starts = set(trajectory.drive_start[:-1].tolist())
        for first, last in segment_ends(trajectory.drive_start, segment_start).tolist():
            if first in starts:
                node_scan.append(first)
            node_scan.append(last)
            edge_nodes.append((len(node_scan) - 2, len(node_scan) - 1))
            lengths_m.append(trajectory.path_m(first, last))
        return cls(np.array(node_scan), np.array(edge_nodes), np.array(lengths_m))


def segment_ends(drive_start: IntArray, segment_start: IntArray) -> IntArray:
    """Return the rows of the scans at which each segment begins and ends, `(L, 2)`.

    It ends where the next one of its drive begins; a drive's last segment at its last scan.

    Examples:
        >>> segment_ends(np.array([0, 4, 6]), np.array([0, 2, 4, 6])).tolist()
        [[0, 2], [2, 3], [4, 5]]
    """
    ends = segment_start[1:]
    return np.stack([segment_start[:-1], ends - np.isin(ends, drive_start)], axis=1)
