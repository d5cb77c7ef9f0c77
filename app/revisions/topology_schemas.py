"""A map's graph on the wire."""

from pydantic import BaseModel, Field

from app.drives.pose_schemas import PoseOut
from core.mapping.georeference import NOWHERE, Georeference
from core.mapping.tensormap import TensorMap
from core.numbers import none_if_nan
from core.scans.pose import Pose


class NodeOut(BaseModel):
    """A node of the graph: an end or a meeting place of segments."""

    node: int
    drive: str
    scan_index: int
    pose: PoseOut | None


class EdgeSegmentOut(BaseModel):
    """A segment that runs along an edge."""

    segment: int
    reversed: bool = Field(description="Whether it runs from the edge's second node to its first.")
    scans: int = Field(description="The segment's length in scans, from node to node.")
    relative_error: float = Field(description="|X - X^| / |X| of its model.")


class EdgeOut(BaseModel):
    """An edge of the graph: a street between two nodes, driven once or more."""

    edge: int
    segment: int = Field(description="The first segment along it.")
    nodes: tuple[int, int]
    scans: int = Field(description="Length in scans, from node to node, of its first segment.")
    length_m: float | None = Field(
        description="Length in metres, from node to node, of its first segment; null without poses."
    )
    relative_error: float = Field(description="|X - X^| / |X| of the model of that segment.")
    segments: list[EdgeSegmentOut] = Field(description="All segments along it, in order.")


class TopologyOut(BaseModel):
    """A map as a graph."""

    revision: str
    nodes: list[NodeOut]
    edges: list[EdgeOut]

    @classmethod
    def from_core(
        cls, tensor_map: TensorMap, georeference: Georeference = NOWHERE
    ) -> "TopologyOut":
        """Return the model of a map's graph."""
        topology, trajectory = tensor_map.topology, tensor_map.trajectory
        lengths = tensor_map.segment_ends[:, 1] - tensor_map.segment_ends[:, 0]
        along: list[list[EdgeSegmentOut]] = [[] for _ in range(topology.edges)]
        for segment, edge in enumerate(topology.edge_of_segment.tolist()):
            along[edge].append(
                EdgeSegmentOut(
                    segment=segment,
                    reversed=bool(topology.segment_reversed[segment]),
                    scans=int(lengths[segment]),
                    relative_error=float(tensor_map.relative_error[segment]),
                )
            )
        nodes = []
        for node, row in enumerate(topology.node_scan.tolist()):
            pose = Pose.from_row(trajectory.poses[row])
            drive = trajectory.drives[trajectory.drive_of_scan[row]]
            nodes.append(
                NodeOut.model_validate(
                    {
                        "node": node,
                        "drive": drive,
                        "scan_index": int(trajectory.scan_index[row]),
                        "pose": georeference.pose(drive, pose),
                    }
                )
            )
        edges = []
        for edge, segments in enumerate(along):
            first, last = topology.edge_nodes[edge].tolist()
            edges.append(
                EdgeOut(
                    edge=edge,
                    segment=segments[0].segment,
                    nodes=(first, last),
                    scans=int(topology.edge_scans[edge]),
                    length_m=none_if_nan(topology.edge_length_m[edge]),
                    relative_error=segments[0].relative_error,
                    segments=segments,
                )
            )
        return cls(revision=tensor_map.revision, nodes=nodes, edges=edges)
