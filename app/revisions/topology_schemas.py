"""A map's graph over the wire."""

import math

from pydantic import BaseModel, Field

from app.drives.pose_schemas import PoseOut
from core.mapping.tensormap import TensorMap
from core.scans.pose import Pose


class NodeOut(BaseModel):
    """A node of the graph: where segments end, drives turn or meet."""

    node: int
    drive: str
    scan_index: int
    pose: PoseOut | None


class EdgeSegmentOut(BaseModel):
    """A segment that runs along an edge."""

    segment: int
    reversed: bool = Field(description="Whether it runs from the edge's second node to its first.")
    scans: int = Field(description="Its length in scans, from node to node.")
    relative_error: float = Field(description="|X - X^| / |X| of its model.")


class EdgeOut(BaseModel):
    """An edge of the graph: a street between two nodes, driven once or more."""

    edge: int
    segment: int = Field(description="The first segment along it.")
    nodes: tuple[int, int]
    scans: int = Field(description="Length in scans, from node to node, of its first segment.")
    length_m: float | None = Field(description="The same in metres; null without poses.")
    relative_error: float = Field(description="|X - X^| / |X| of the model of that segment.")
    segments: list[EdgeSegmentOut] = Field(description="All segments along it, in order.")


class TopologyOut(BaseModel):
    """A map as a graph."""

    revision: str
    nodes: list[NodeOut]
    edges: list[EdgeOut]

    @classmethod
    def from_core(cls, tensor_map: TensorMap) -> "TopologyOut":
        """Show a map's graph."""
        topology = tensor_map.topology
        along = _along(tensor_map)
        edges = zip(
            topology.edge_nodes.tolist(),
            topology.edge_scans.tolist(),
            topology.edge_length_m.tolist(),
            strict=True,
        )
        return cls(
            revision=tensor_map.revision,
            nodes=[
                _node(tensor_map, node, row) for node, row in enumerate(topology.node_scan.tolist())
            ],
            edges=[
                EdgeOut(
                    edge=edge,
                    segment=along[edge][0].segment,
                    nodes=(first, last),
                    scans=scans,
                    length_m=None if math.isnan(length_m) else length_m,
                    relative_error=along[edge][0].relative_error,
                    segments=along[edge],
                )
                for edge, ((first, last), scans, length_m) in enumerate(edges)
            ],
        )


def _along(tensor_map: TensorMap) -> list[list[EdgeSegmentOut]]:
    topology = tensor_map.topology
    along: list[list[EdgeSegmentOut]] = [[] for _ in range(topology.edges)]
    for segment, (edge, turned, (first, last), error) in enumerate(
        zip(
            topology.edge_of_segment.tolist(),
            topology.segment_reversed.tolist(),
            tensor_map.segment_ends.tolist(),
            tensor_map.relative_error.tolist(),
            strict=True,
        )
    ):
        along[edge].append(
            EdgeSegmentOut(
                segment=segment, reversed=turned, scans=last - first, relative_error=error
            )
        )
    return along


def _node(tensor_map: TensorMap, node: int, row: int) -> NodeOut:
    trajectory = tensor_map.trajectory
    pose = Pose.from_row(trajectory.poses[row])
    return NodeOut(
        node=node,
        drive=trajectory.drives[trajectory.drive_of_scan[row]],
        scan_index=int(trajectory.scan_index[row]),
        pose=None if pose is None else PoseOut.from_core(pose),
    )
