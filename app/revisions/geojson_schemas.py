"""A map on the Earth on the wire: what GeoJSON (RFC 7946) has of it."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from app.drives.pose_schemas import PoseOut

Position = Annotated[
    list[float],
    Field(min_length=3, max_length=3, description="Longitude, latitude, and altitude in metres."),
]
Line = Annotated[list[Position], Field(min_length=2)]


class PointOut(BaseModel):
    """Where a node is."""

    type: Literal["Point"]
    coordinates: Position


class LineStringOut(BaseModel):
    """A street in one piece."""

    type: Literal["LineString"]
    coordinates: Line


class MultiLineStringOut(BaseModel):
    """A drive, or a street with gaps."""

    type: Literal["MultiLineString"]
    coordinates: list[Line]


class DriveFactsOut(BaseModel):
    """A drive: its geometry is a MultiLineString."""

    kind: Literal["drive"]
    drive: str
    scans: int = Field(description="Scans with a pose.")


class EdgeFactsOut(BaseModel):
    """An edge of the topology."""

    kind: Literal["edge"]
    edge: int
    nodes: tuple[int, int]
    scans: int = Field(description="Length in scans, from node to node, of its first segment.")
    length_m: float | None


class NodeFactsOut(BaseModel):
    """A node of the topology: its geometry is a Point."""

    kind: Literal["node"]
    node: int
    drive: str
    scan_index: int
    pose: PoseOut = Field(description="In the map's frame, without `wgs84`.")


class FeatureOut(BaseModel):
    """A drive, an edge or a node."""

    type: Literal["Feature"]
    geometry: PointOut | LineStringOut | MultiLineStringOut = Field(discriminator="type")
    properties: DriveFactsOut | EdgeFactsOut | NodeFactsOut = Field(discriminator="kind")


class FeaturesOut(BaseModel):
    """The drives, edges and nodes of a map that have a place on the Earth."""

    type: Literal["FeatureCollection"]
    features: list[FeatureOut]
