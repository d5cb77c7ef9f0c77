"""The map as a graph: nodes where segments end, edges along segments (paper, sec. 1)."""

from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray, IntArray, frozen
from core.errors import InvalidMap
from core.pose import path_length_m
from core.trajectory import Trajectory

__all__ = ["Topology"]


@dataclass(frozen=True, eq=False)
class Topology:
    """Nodes and edges; edge `l` is segment `l`.

    Attributes:
        node_scan: `(N,)` the map row whose scan stands at the node.
        edge_nodes: `(L, 2)` the nodes where a segment begins and ends.
        edge_length_m: `(L,)` length of the path in metres, NaN where a pose on it is unknown.
    """

    node_scan: IntArray
    edge_nodes: IntArray
    edge_length_m: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "node_scan", frozen(self.node_scan, np.int64))
        object.__setattr__(self, "edge_nodes", frozen(self.edge_nodes, np.int64))
        object.__setattr__(self, "edge_length_m", frozen(self.edge_length_m, np.float64))
        edges = len(self.edge_length_m)
        if self.node_scan.ndim != 1:
            raise InvalidMap(f"node_scan has shape {self.node_scan.shape}, wanted (N,)")
        if self.edge_length_m.ndim != 1:
            raise InvalidMap(f"edge_length_m has shape {self.edge_length_m.shape}, wanted (L,)")
        if (self.edge_length_m < 0).any() or np.isinf(self.edge_length_m).any():
            raise InvalidMap("edge_length_m holds negative or infinite numbers")
        if self.edge_nodes.shape != (edges, 2):
            raise InvalidMap(f"edge_nodes has shape {self.edge_nodes.shape}, wanted ({edges}, 2)")
        if edges and not (
            self.edge_nodes.min() >= 0 and self.edge_nodes.max() < len(self.node_scan)
        ):
            raise InvalidMap("edge_nodes names a node that does not exist")

    @property
    def edge_scans(self) -> IntArray:
        """Length of each edge in scans, from node to node, `(L,)`."""
        return np.diff(self.node_scan[self.edge_nodes], axis=1)[:, 0]

    @classmethod
    def of_segments(cls, trajectory: Trajectory, segment_start: IntArray) -> "Topology":
        """Join each segment to the next one of its drive.

        A node stands at a segment's first scan, which is where the one before ends; a drive's
        last segment ends at its last scan.
        """
        node_scan: list[int] = []
        edge_nodes: list[tuple[int, int]] = []
        lengths_m: list[float] = []
        drive_ends = set(trajectory.drive_start[1:].tolist())
        fresh = True
        for start, end in zip(segment_start[:-1].tolist(), segment_start[1:].tolist(), strict=True):
            if fresh:
                node_scan.append(start)
            fresh = end in drive_ends
            last = end - 1 if fresh else end
            node_scan.append(last)
            edge_nodes.append((len(node_scan) - 2, len(node_scan) - 1))
            lengths_m.append(path_length_m(trajectory.poses[start : last + 1]))
        return cls(np.array(node_scan), np.array(edge_nodes), np.array(lengths_m))
