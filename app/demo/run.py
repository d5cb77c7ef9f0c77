"""The demonstration, step by step."""

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Protocol

import numpy as np

from app.builds.parameters import BuildParameters
from app.demo.client import Client
from app.demo.errors import DemoFailed
from app.demo.outcome import MAX_SCANS, RECALL_M, Fixes, Outcome
from app.localization.schemas import LocalizationOut
from app.revisions.topology_schemas import EdgeOut
from core.arrays import BoolArray
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
from storage.catalog import JobState
from storage.formats.scans.kitti import kitti_body

_DRIVE = "recorded"
# Longer segments are recalled better (paper, sec. 3.2): two are the fewest that can be mistaken.
_SEGMENTS = 2


class BuildProgress(Progress, Protocol):
    """A progress that can also be set, as a job tells where it is."""

    def move_to(self, done: int) -> None:
        """Set how many units of the stage are done."""


@dataclass(frozen=True, eq=False)
class _Query:
    index: int
    segment: int
    scan: Scan
    body: bytes


def hold_out(drive: Drive) -> BoolArray:
    """Return which of a drive's first 300 scans are not mapped but localized.

    Raises:
        DemoFailed: If there are too few scans for one of them to be.
    """
    scans = min(len(drive), MAX_SCANS)
    cuts = cut_fixed(scans, segment_length_for(scans, segments=_SEGMENTS))
    held_out = Interleaved(0.2).held_out(cuts)
    if not held_out.any():
        raise DemoFailed(f"drive {drive.name} has {scans} scans: too few to hold one in five out")
    return held_out


def run_demo(
    client: Client,
    drive: Drive,
    held_out: BoolArray,
    progress: BuildProgress,
    encoding: str = DEFAULT_ENCODING,
) -> Outcome:
    """Record a drive, map four fifths of it over HTTP and localize the rest.

    Args:
        client: Of a service that does not have the client's map yet.
        drive: The drive.
        held_out: Of its scans, as `hold_out` gives it; those beyond are not used.
        progress: Told of each stage.
        encoding: Of the map.

    Raises:
        DemoFailed: If the service refuses something.
    """
    client.create_map(f"Demonstration: {drive.name}")
    posted, returns = 0, 0
    recorded: list[int] = []
    queries: list[tuple[int, Scan]] = []
    progress.start("recording and posting", len(held_out))
    for index in range(len(held_out)):
        try:
            scan = drive.scan(index)
        except InvalidScan:  # as on the road: it is left out
            progress.advance()
            continue
        if held_out[index]:
            queries.append((index, scan))
        else:
            body = kitti_body(scan)
            client.put_scan(_DRIVE, index, body, scan)
            recorded.append(index)
            posted += len(body)
            returns += len(scan)
        progress.advance()
    mapped = _build(client, progress, encoding)
    basis = client.basis().to_core()
    edges = client.topology().edges
    edge_of = {along.segment: edge.edge for edge in edges for along in edge.segments}
    starts = _segment_starts(edges)
    asked = [
        _Query(index, _segment_at(starts, recorded, index), scan, kitti_body(scan))
        for index, scan in queries
        if _is_usable(basis, scan)
    ]
    if not asked:
        raise DemoFailed(f"not one held-out scan of drive {drive.name} can be projected")
    segments = len(edge_of)
    ways = _ways(client, basis)
    progress.start("localizing", len(ways) * len(asked))
    return Outcome(
        fixes=tuple(
            _ask(name, asked, drive, edge_of, answer, progress) for name, answer in ways.items()
        ),
        compression=Compression.of(
            basis.parameters.encoder.elements(basis.parameters, segments, mapped),
            scans=mapped,
            grid_shape=basis.parameters.grid.shape,
            returns=returns,
        ),
        segments=segments,
        mapped_scans=mapped,
        posted_bytes=posted,
    )


def _ways(
    client: Client, basis: Basis
) -> dict[str, Callable[[_Query], tuple[LocalizationOut, int]]]:
    """Return the ways to ask, by what is sent."""
    whole = {"full scan": lambda q: _by_scan(client, q)}
    encoder = basis.parameters.encoder
    if encoder.per_segment:
        return {
            **whole,
            "signatures, all segments": lambda q: _by_signature(client, basis, q, None),
            "signature, segment known": lambda q: _by_signature(client, basis, q, q.segment),
        }
    return {
        **whole,
        **{
            f"signature, {packing}": partial(_packed, client, basis, packing)
            for packing in sorted(encoder.packings)
        },
    }


def _build(client: Client, progress: BuildProgress, encoding: str) -> int:
    """Build the map as a job, and return how many scans it holds."""
    parameters = BuildParameters(encoding=encoding, segments=_SEGMENTS)
    if parameters.map_parameters().reducer == Reducer.LAST:  # depends on the order of returns
        parameters = parameters.model_copy(update={"reducer": Reducer.NEAREST})
    job = client.build(parameters)
    stage = ""
    while job.state != JobState.DONE:
        job = client.follow(job)
        if job.stage and job.stage != stage:
            stage = job.stage
            progress.start(f"build: {stage}", job.total)
        if stage:
            progress.move_to(job.done)
    return client.mapped_scans()


def _ask(
    name: str,
    queries: Sequence[_Query],
    drive: Drive,
    edge_of: dict[int, int],
    answer: Callable[[_Query], tuple[LocalizationOut, int]],
    progress: Progress,
) -> Fixes:
    right, sent, error_m = [], [], []
    begun = time.perf_counter()
    for query in queries:
        found, size = answer(query)
        # Where a drive passes a street twice, both passes are segments of one edge.
        right.append(edge_of[found.best.segment] == edge_of[query.segment])
        sent.append(size)
        if found.best.pose is not None:  # of the map's scan: recall is of places, not of estimates
            place = (found.best.pose.x_m, found.best.pose.y_m, found.best.pose.z_m)
            error_m.append(float(np.linalg.norm(drive.poses[query.index, :3] - place)))
        progress.advance()
    seconds = time.perf_counter() - begun
    return Fixes(
        asked_by=name,
        queries=len(queries),
        segment_accuracy=float(np.mean(right)),
        recall_at_1=float(np.mean(np.array(error_m) <= RECALL_M)) if error_m else None,
        position_error_m=float(np.median(error_m)) if error_m else None,
        bytes_per_fix=float(np.mean(sent)),
        ms_per_fix=1e3 * seconds / len(queries),
    )


def _by_scan(client: Client, query: _Query) -> tuple[LocalizationOut, int]:
    return client.localize_scan(query.body), len(query.body)


def _by_signature(
    client: Client,
    basis: Basis,
    query: _Query,
    segment: int | None,
    packing: Packing | None = None,
) -> tuple[LocalizationOut, int]:
    """Make the signatures on the client's side and send nothing else."""
    signatures = basis.encode(basis.image(query.scan))
    if segment is not None:
        signatures = tuple(s for s in signatures if s.segment == segment)
    packed = pack_signatures(signatures, packing)
    return client.localize_signature(packed), len(packed)


def _packed(
    client: Client, basis: Basis, packing: Packing, query: _Query
) -> tuple[LocalizationOut, int]:
    return _by_signature(client, basis, query, None, packing)


def _is_usable(basis: Basis, scan: Scan) -> bool:
    """Return whether a vehicle could ask with this scan at all."""
    try:
        basis.image(scan)
    except InvalidScan:
        return False
    return True


def _segment_starts(edges: Sequence[EdgeOut]) -> list[int]:
    """Return at which of the map's scans each segment of its only drive begins."""
    lengths = {along.segment: along.scans for edge in edges for along in edge.segments}
    return list(accumulate((lengths[s] for s in sorted(lengths)), initial=0))[:-1]


def _segment_at(starts: Sequence[int], recorded: Sequence[int], index: int) -> int:
    """Return the segment that scan `index` lies on, by the recorded scans before it."""
    return max(0, bisect_right(starts, bisect_left(recorded, index)) - 1)
