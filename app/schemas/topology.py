"""A map's graph over the wire."""

import math

from pydantic import BaseModel, Field

from app.schemas.poses import PoseOut
from core.pose import Pose
from core.tensormap import TensorMap

__all__ = ["TopologyOut"]


class NodeOut(BaseModel):
    """A node of the graph: where segments end."""

    node: int
    drive: str
    scan_index: int
    pose: PoseOut | None


class EdgeOut(BaseModel):
    """An edge of the graph: a segment."""

    segment: int
    nodes: tuple[int, int]
    scans: int = Field(description="Length in scans, from node to node.")
    length_m: float | None = Field(description="Length in metres; null without poses.")
    relative_error: float = Field(description="|X - X^| / |X| of its model.")


class TopologyOut(BaseModel):
    """A map as a graph."""

    revision: str
    nodes: list[NodeOut]
    edges: list[EdgeOut]

    @classmethod
    def from_core(cls, tensor_map: TensorMap) -> "TopologyOut":
        """Show a map's graph."""
        topology = tensor_map.topology
        edges = zip(
            topology.edge_nodes.tolist(),
            topology.edge_scans.tolist(),
            topology.edge_length_m.tolist(),
            tensor_map.relative_error.tolist(),
            strict=True,
        )
        return cls(
            revision=tensor_map.revision,
            nodes=[
                _node(tensor_map, node, row) for node, row in enumerate(topology.node_scan.tolist())
            ],
            edges=[
                EdgeOut(
                    segment=segment,
                    nodes=(first, last),
                    scans=scans,
                    length_m=None if math.isnan(length_m) else length_m,
                    relative_error=error,
                )
                for segment, ((first, last), scans, length_m, error) in enumerate(edges)
            ],
        )


def _node(tensor_map: TensorMap, node: int, row: int) -> NodeOut:
    trajectory = tensor_map.trajectory
    pose = Pose.from_row(trajectory.poses[row])
    return NodeOut(
        node=node,
        drive=trajectory.drives[trajectory.drive_of_scan[row]],
        scan_index=int(trajectory.scan_index[row]),
        pose=None if pose is None else PoseOut.from_core(pose),
    )
