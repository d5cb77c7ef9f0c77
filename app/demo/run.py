"""The demonstration, step by step."""

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from tensormap_client import Mapper
from tensormap_client import Progress as TransferProgress

from app.builds.parameters import BuildParameters
from app.demo.client import DemoClient
from app.demo.errors import DemoFailed
from app.demo.mapped_scans import MappedScans
from app.demo.outcome import MAX_SCANS, RECALL_M, Fixes, Outcome
from app.drives.pose_schemas import PoseOut
from app.revisions.topology_schemas import EdgeOut
from core.arrays import BoolArray, FloatArray
from core.encodings.basis import Basis
from core.encodings.compression import Compression
from core.encodings.registry import DEFAULT_ENCODING
from core.encodings.signature import Packing, pack_signatures
from core.errors import InvalidScan
from core.evaluation.split import Interleaved
from core.progress import Progress
from core.projection.reducer import Reducer
from core.scans.drive import Drive
from core.scans.scan import Scan
from core.segmentation.fixed import cut_fixed, segment_length_for
from core.text import count_of
from storage.formats.scans.kitti import kitti_body

_DRIVE = "recorded"
# Longer segments have a higher recall (paper, sec. 3.2); with one, none could be wrong.
_SEGMENTS = 2


@dataclass(frozen=True, eq=False)
class _Query:
    index: int
    segments: tuple[int, ...]
    scan: Scan
    body: bytes


class _Way(NamedTuple):
    """A kind of request to localize a scan with."""

    name: str
    kind: str
    body_of: Callable[[_Query], bytes]


def hold_out(drive: Drive) -> BoolArray:
    """Return which of a drive's first 300 scans are localized instead of mapped.

    Raises:
        DemoFailed: If there are too few scans.
    """
    scans = min(len(drive), MAX_SCANS)
    cuts = cut_fixed(scans, segment_length_for(scans, segments=_SEGMENTS))
    held_out = Interleaved(0.2).held_out(cuts)
    if not held_out.any():
        raise DemoFailed(
            f"drive {drive.name} has {count_of(scans, 'scan')}: too few to hold one in five out"
        )
    return held_out


def run_demo(
    mapper: Mapper,
    client: DemoClient,
    drive: Drive,
    held_out: BoolArray,
    progress: TransferProgress,
    encoding: str = DEFAULT_ENCODING,
) -> Outcome:
    """Record a drive, map four fifths of it over HTTP and localize the rest.

    Args:
        mapper: The mapper of a map that its service does not have yet.
        client: The client of the same map.
        drive: The drive.
        held_out: The scans to localize, from `hold_out`; later scans are not used.
        progress: Receives each stage.
        encoding: The map's encoding.

    Raises:
        DemoFailed: If the service refuses a query, or ends.
        ClientError: If it refuses another request.
    """
    mapper.create_map(f"Demonstration: {drive.name}")
    mapped_scans = MappedScans(drive, held_out)
    posted = mapper.upload(mapped_scans, _DRIVE, progress).sent_bytes
    mapper.build(_parameters(encoding).as_json(), progress)
    queries = []
    progress.start("recording", int(held_out.sum()))
    for index in np.flatnonzero(held_out).tolist():
        with suppress(InvalidScan):
            queries.append((index, drive.scan(index)))
        progress.advance()
    mapped = client.mapped_scans()
    basis = client.basis().to_core()
    edges = client.topology().edges
    edge_of = {along.segment: edge.edge for edge in edges for along in edge.segments}
    starts = _segment_starts(edges)
    usable = [
        _Query(index, _segments_at(starts, mapped_scans.recorded, index), scan, kitti_body(scan))
        for index, scan in queries
        if _is_usable(basis, scan)
    ]
    if not usable:
        raise DemoFailed(f"not one held-out scan of drive {drive.name} can be projected")
    segments = len(edge_of)
    ways = _ways(basis)
    progress.start("localizing", len(ways) * len(usable))
    return Outcome(
        fixes=tuple(_localize(client, way, usable, drive, edge_of, progress) for way in ways),
        compression=Compression.of(
            basis.parameters.encoder.elements(basis.parameters, segments, mapped),
            scans=mapped,
            grid_shape=basis.parameters.grid.shape,
            returns=mapped_scans.returns,
        ),
        segments=segments,
        mapped_scans=mapped,
        posted_bytes=posted,
    )


def _ways(basis: Basis) -> list[_Way]:
    """Return the kinds of requests to localize a scan with."""

    def packed(query: _Query, packing: Packing | None = None, segment: int | None = None) -> bytes:
        signatures = basis.encode(basis.image(query.scan))
        if segment is not None:
            signatures = tuple(s for s in signatures if s.segment == segment)
        return pack_signatures(signatures, packing)

    encoder = basis.parameters.encoder
    ways = [_Way("full scan", "scan", lambda query: query.body)]
    if encoder.per_segment:
        return [
            *ways,
            _Way("signatures, all segments", "signature", packed),
            _Way(
                "signature, segment known", "signature", lambda q: packed(q, segment=q.segments[0])
            ),
        ]
    return ways + [
        _Way(f"signature, {packing}", "signature", partial(packed, packing=packing))
        for packing in sorted(encoder.packings)
    ]


def _parameters(encoding: str) -> BuildParameters:
    """Return the parameters of the map."""
    parameters = BuildParameters(encoding=encoding, segments=_SEGMENTS)
    if parameters.map_parameters().reducer == Reducer.LAST:  # depends on the order of returns
        return parameters.model_copy(update={"reducer": Reducer.NEAREST})
    return parameters


def _localize(
    client: DemoClient,
    way: _Way,
    queries: Sequence[_Query],
    drive: Drive,
    edge_of: dict[int, int],
    progress: Progress,
) -> Fixes:
    right, sent, scan_error_m, error_m = [], [], [], []
    begun = time.perf_counter()
    for query in queries:
        body = way.body_of(query)
        best = client.localize(way.kind, body).best
        # Where a drive passes a street twice, both passes are segments of one edge.
        right.append(edge_of[best.segment] in {edge_of[s] for s in query.segments})
        sent.append(len(body))
        true_m = drive.poses[query.index, :3]
        # Without poses of its own a drive is mapped with those of the odometry, and the held-out
        # scans have none.
        if best.pose is not None and np.isfinite(true_m).all():
            scan_error_m.append(_apart_m(true_m, best.pose))
            error_m.append(_apart_m(true_m, best.estimated_pose or best.pose))
        progress.advance()
    seconds = time.perf_counter() - begun
    return Fixes(
        request=way.name,
        queries=len(queries),
        segment_accuracy=float(np.mean(right)),
        # Of the map's scan: recall is of places, not of estimates.
        recall_at_1=float(np.mean(np.array(scan_error_m) <= RECALL_M)) if error_m else None,
        position_error_m=float(np.median(error_m)) if error_m else None,
        bytes_per_fix=float(np.mean(sent)),
        ms_per_fix=1e3 * seconds / len(queries),
    )


def _apart_m(true_m: FloatArray, pose: PoseOut) -> float:
    return float(np.linalg.norm(true_m - (pose.x_m, pose.y_m, pose.z_m)))


def _is_usable(basis: Basis, scan: Scan) -> bool:
    """Return whether a scan has returns inside the grid."""
    try:
        basis.image(scan)
    except InvalidScan:
        return False
    return True


def _segment_starts(edges: Sequence[EdgeOut]) -> list[int]:
    """Return the rows of the map where each segment of its only drive begins."""
    lengths = {along.segment: along.scans for edge in edges for along in edge.segments}
    return list(accumulate((lengths[s] for s in sorted(lengths)), initial=0))[:-1]


def _segments_at(starts: Sequence[int], recorded: Sequence[int], index: int) -> tuple[int, ...]:
    """Return the segments of the recorded scans before and after scan `index`, each once.

    A scan between two segments is of either: the map does not know where between its own scans one
    ends.
    """
    after = bisect_left(recorded, index)
    rows = (max(0, after - 1), min(after, len(recorded) - 1))
    return tuple(dict.fromkeys(bisect_right(starts, row) - 1 for row in rows))
