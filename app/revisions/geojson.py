"""A map on the Earth, as GeoJSON (RFC 7946)."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from app.revisions.topology_schemas import TopologyOut
from core.arrays import FloatArray, IntArray
from core.mapping.anchor import Anchor
from core.mapping.georeference import Georeference
from core.mapping.tensormap import TensorMap

GEOJSON = "application/geo+json"

_DIGITS = 8  # of degrees: a millimetre
_GAP_M = 25.0  # between scans: the path in between is not known


def features_of(tensor_map: TensorMap, georeference: Georeference) -> list[dict[str, Any]]:
    """Return a feature for each drive, edge and node that has a place on the Earth."""
    return [
        *_drives(tensor_map, georeference),
        *_streets(tensor_map, georeference),
    ]


def _drives(tensor_map: TensorMap, georeference: Georeference) -> Iterator[dict[str, Any]]:
    trajectory = tensor_map.trajectory
    for position, drive in enumerate(trajectory.drives):
        rows = np.flatnonzero((trajectory.drive_of_scan == position) & trajectory.known)
        anchor = georeference.of(drive)
        if anchor is not None and len(rows):
            lines = _lines(anchor, rows, trajectory.poses[rows, :3])
            geometry = {"type": "MultiLineString", "coordinates": lines}
            yield _feature(geometry, kind="drive", drive=drive, scans=len(rows))


def _streets(tensor_map: TensorMap, georeference: Georeference) -> Iterator[dict[str, Any]]:
    shown = TopologyOut.from_core(tensor_map, georeference).model_dump(mode="json")
    trajectory, ends = tensor_map.trajectory, tensor_map.segment_ends
    for edge in shown["edges"]:
        first, last = ends[edge["segment"]].tolist()
        rows = np.arange(first, last + 1)
        rows = rows[trajectory.known[rows]]
        anchor = georeference.of(trajectory.drives[trajectory.drive_of_scan[first]])
        if anchor is not None and len(rows) > 1:
            lines = _lines(anchor, rows, trajectory.poses[rows, :3])
            geometry = (
                {"type": "LineString", "coordinates": lines[0]}
                if len(lines) == 1
                else {"type": "MultiLineString", "coordinates": lines}
            )
            facts = {name: edge[name] for name in ("edge", "nodes", "scans", "length_m")}
            yield _feature(geometry, kind="edge", **facts)
    for node in shown["nodes"]:
        pose = node.pop("pose")
        if pose is not None and (place := pose.pop("wgs84", None)) is not None:
            names = ("longitude_deg", "latitude_deg", "altitude_m")
            point = [round(place[name], _DIGITS) for name in names]
            yield _feature({"type": "Point", "coordinates": point}, kind="node", **node, pose=pose)


def _feature(geometry: dict[str, Any], **properties: object) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _lines(anchor: Anchor, rows: IntArray, points_m: FloatArray) -> list[list[list[float]]]:
    """Return the lines along scans with poses, none across a gap or 180 degrees of longitude."""
    return [
        line
        for some_m in _unbroken(rows, points_m)
        for line in _cut_at_180_deg(_positions(anchor, some_m))
    ]


def _positions(anchor: Anchor, points_m: FloatArray) -> list[list[float]]:
    latitude, longitude, altitude_m = anchor.wgs84(points_m).T
    found: list[list[float]] = (
        np.stack([longitude, latitude, altitude_m], 1).round(_DIGITS).tolist()
    )
    return found * 2 if len(found) == 1 else found  # a line has two positions at least


def _cut_at_180_deg(line: list[list[float]]) -> list[list[list[float]]]:
    """Return the parts of a line on either side of 180 degrees of longitude (RFC 7946, 3.1.9).

    A position on that meridian is 180 or -180 degrees, as the part that it is in.
    """
    if np.abs(np.diff([position[0] for position in line])).max() <= 180.0:
        return [line]
    parts, part = [], line[:1]
    for there in line[1:]:
        here = part[-1]
        edge_deg = math.copysign(180.0, here[0])
        if there[0] == -edge_deg:
            there = [edge_deg, *there[1:]]
        if abs(there[0] - here[0]) > 180.0:
            share = (edge_deg - here[0]) / (there[0] + 2.0 * edge_deg - here[0])
            middle = [
                round(a + share * (b - a), _DIGITS)
                for a, b in zip(here[1:], there[1:], strict=True)
            ]
            if share > 0.0:
                part = [*part, [edge_deg, *middle]]
            if len(part) > 1:  # else the line begins on the meridian
                parts.append(part)
            part = [[-edge_deg, *middle]]
        part.append(there)
    return [*parts, part]


def _unbroken(rows: IntArray, points_m: FloatArray) -> list[FloatArray]:
    """Return the points of each stretch without a gap."""
    apart_m = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    return np.split(points_m, 1 + np.flatnonzero((apart_m > _GAP_M) | (np.diff(rows) > 1)))
