"""How the conformance kit was made: `python -m tests.vectors.make`.

Clients in use were tested with its outcomes: they stay what they are. Whoever adds a case runs this
and looks at the difference, which is that case.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from app.revisions.loaded import Answering
from app.revisions.schemas import BasisOut
from core.arrays import Float32Array, FloatArray
from core.confidence.decision import Decision, Refusal
from core.confidence.spread import Deviation
from core.encodings.basis import Basis
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.paper.basis import PaperBasis, paper_basis_digests
from core.encodings.signature import Packing
from core.localization.localizer import Localization, Localizer
from core.localization.match import Match
from core.parameters import MapParameters
from core.projection.imager import ImageKind, Views
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.pose import Pose
from core.scans.sensor import AngularGrid
from tests.golden.make import golden_harmonic_map
from tests.vectors import outcomes
from tests.vectors.outcomes import FOLDER, Values
from tests.vectors.scenes import SENSOR_HEIGHT_M, kit_scans, limits

_REVISION = "5eed" * 16
_WOBBLE = 1e-12  # of the largest number: far beyond what the order of a sum changes


def main() -> None:
    """Write all files of the kit."""
    for name in ("scans", "bases"):
        (FOLDER / name).mkdir(exist_ok=True)
    for name, points_m in kit_scans().items():
        rows = np.zeros((len(points_m), 4), "<f4")
        rows[:, :3] = points_m
        (FOLDER / "scans" / f"{name}.bin").write_bytes(rows.tobytes())
    for name, basis in kit_bases().items():
        answer = BasisOut.from_core(basis).model_dump(mode="json")
        (FOLDER / "bases" / f"{name}.json").write_text(json.dumps(answer) + "\n")
    _write(FOLDER / "signatures.json", signature_cases())
    _write(FOLDER / "planes.json", plane_cases())
    _write(FOLDER / "packing.json", packing_cases())
    _write(FOLDER / "answers.json", answer_cases())


def kit_bases() -> dict[str, Basis]:
    """Return a basis of every kind of image; their numbers are whole multiples of 1/512."""
    of_heights = MapParameters.for_sensor(encoding="harmonic")
    full = replace(
        of_heights, views=Views.FULL, verification_images=False, ranks=(5, 5), sensor_height_m=1.6
    )
    of_ranges = MapParameters.for_sensor(
        encoding="harmonic", image=ImageKind.RANGE, ranks=(4, 6), reducer=Reducer.MEAN
    )
    coarse = AngularGrid(-50.0, 10.0, 11, 2.0, wraps=True)
    odd_rows = AngularGrid(-15.0, 2.0, 16, 2.0)
    paper = MapParameters.for_sensor(encoding="paper", ranks=(4, 3))
    return {
        "any-views": _harmonic(1, of_heights),
        "any-views-coarse": _harmonic(
            10, replace(of_heights, grid=RingGrid(5.0, 12, 4.0), ranks=(5, 6))
        ),
        "any-views-fine": _harmonic(
            11, replace(of_heights, grid=RingGrid(2.0, 30, 2.0), ranks=(8, 7))
        ),
        "heights-highest": _harmonic(2, full),
        "heights-mean": _harmonic(
            3, replace(full, reducer=Reducer.MEAN, grid=RingGrid(2.5, 16, 2.0), ranks=(4, 6))
        ),
        "ranges-mean": _harmonic(4, of_ranges),
        "ranges-coarse": _harmonic(5, replace(of_ranges, grid=coarse)),
        "paper-last": _paper(6, paper, segments=(0, 1)),
        "paper-nearest": _paper(
            7, replace(paper, grid=odd_rows, reducer=Reducer.NEAREST), segments=(3,)
        ),
        "paper-farthest": _paper(
            8, replace(paper, grid=odd_rows, reducer=Reducer.FARTHEST), segments=(0, 2)
        ),
        "paper-mean": _paper(
            9, replace(paper, grid=odd_rows, reducer=Reducer.MEAN), segments=(65535,)
        ),
    }


def _harmonic(seed: int, parameters: MapParameters) -> Basis:
    kept, _ = parameters.encoder.kept_ranks(parameters)
    [u] = _columns(seed, 1, parameters.grid.rows, kept)
    return HarmonicBasis.of(parameters, u, _REVISION)


def _paper(seed: int, parameters: MapParameters, segments: tuple[int, ...]) -> Basis:
    (rows, columns), (r1, r2) = parameters.grid.shape, parameters.ranks
    u = _columns(seed, len(segments), rows, r1)
    v = _columns(seed + 100, len(segments), columns, r2)
    digest = paper_basis_digests(parameters, u, v)[-1]
    return PaperBasis(_REVISION, digest, parameters, np.array(segments), u, v)


def _columns(seed: int, count: int, rows: int, rank: int) -> Float32Array:
    """Return columns that are nearly orthonormal, the first without a change of sign."""
    rng = np.random.default_rng(seed)
    numbers = rng.normal(size=(count, rows, rank))
    numbers[:, :, 0] = 1.0 + 0.3 * rng.random((count, rows))
    return np.asarray(np.rint(512.0 * np.linalg.qr(numbers)[0]) / 512.0, np.float32)


def signature_cases() -> Iterator[Values]:
    """Yield scans, and what they become with a basis."""
    tried = [
        *(("street", basis, {}) for basis in kit_bases()),
        ("tilted", "any-views", {}),
        ("tilted", "any-views", {"sensor_height_m": 1.9}),
        ("tilted", "heights-highest", {}),
        ("pitched", "any-views", {}),
        ("pitched", "any-views", {"roll_deg": -6.0, "pitch_deg": 11.0}),
        ("pitched", "heights-highest", {"roll_deg": -6.0, "pitch_deg": 11.0}),
        ("narrow", "any-views", {}),
        ("narrow", "any-views-coarse", {}),
        ("near", "any-views", {}),
        ("tunnel", "any-views", {}),
        ("tunnel", "any-views-coarse", {}),
        ("lattice", "any-views", {}),
        ("far", "any-views", {}),
        ("far", "paper-last", {}),
        ("far", "ranges-mean", {}),
        *(("odd", basis, {}) for basis in kit_bases()),
        *(("ties", basis, {}) for basis in kit_bases()),
        *(
            (scan, basis, {})
            for scan in ("sectors", "ten", "nine", "forty", "near")
            for basis in ("any-views", "any-views-fine")
            if (scan, basis) != ("near", "any-views")
        ),
        ("middle", "any-views-fine", {}),
        ("beyond", "any-views", {}),
        ("beyond", "paper-last", {}),
        ("high", "heights-highest", {}),
        ("high", "heights-mean", {}),
        ("one", "any-views", {}),
        ("one", "heights-mean", {}),
        ("ground", "any-views", {}),
        ("ground", "heights-highest", {"sensor_height_m": 1.5}),
        ("nothing", "any-views", {}),
        ("nothing", "paper-last", {}),
    ]
    bases = kit_bases()
    for scan, basis, options in tried:
        case = {
            "scan": scan,
            "basis": basis,
            "sensor_height_m": SENSOR_HEIGHT_M,
            "roll_deg": None,
            "pitch_deg": None,
            **options,
        }
        found = outcomes.signature_outcome(case, bases[basis])
        if not found["refused"]:
            _require_sturdy(case, bases[basis], found["packed"])
        yield {**case, **found}


def _require_sturdy(case: Values, basis: Basis, packed: dict[str, str | None]) -> None:
    """Reject a case whose bytes depend on the order of its sums: choose another scan."""
    signatures = basis.encode(outcomes.image_of(case, basis))
    exact = [signature.values.astype(np.complex128) for signature in signatures]
    for seed in range(8):
        rng = np.random.default_rng(seed)
        moved = []
        for signature, values in zip(signatures, exact, strict=True):
            by = _WOBBLE * np.abs(values).max() * rng.uniform(-1.0, 1.0, (2, *values.shape))
            wobbled = values + by[0] + 1j * by[1] * (np.arange(values.shape[1]) > 0)
            if signature.values.dtype.kind != "c":
                wobbled = wobbled.real
            moved.append(replace(signature, values=wobbled.astype(signature.values.dtype)))
        if outcomes.packed_of(basis, moved) != packed:
            raise ValueError(f"{case['scan']} with {case['basis']} is not the same in every order")


def plane_cases() -> Iterator[Values]:
    """Yield a few returns, and the plane of the ground through them."""
    for points_m, height_m in limits():
        case: Values = {"sensor_height_m": height_m, "returns_m": points_m.tolist()}
        yield {**case, "plane": outcomes.plane_outcome(case)}


def packing_cases() -> Iterator[Values]:
    """Yield numbers, and their packed bytes, in every layout and where they are rounded."""
    halves = np.array([[16129.0, 2.25, -6.25, 12.25], [0.25, -0.2499, 0.2501, -0.25]])
    near_halves = np.array([[2049.0, 2051.0], [-2049.0, 65504.0]])
    small = np.array([[6e-8, 2.98e-8], [-3.1e-8, -1e-9]])
    partial = {"hidden": [0, 1, 17, 58, 59], "rings": 15}
    cases: list[tuple[str, FloatArray, Values]] = [
        ("halves of roots are even", halves, {"packing": "int8"}),
        ("the scale of a partial view", halves, {"packing": "int8", **partial}),
        ("a scale that is rounded up", halves * 1.001, {"packing": "int8", **partial}),
        ("a scale that is exact", halves * 127.0**2 / 16129.0, {"packing": "int8", "rings": 3}),
        ("nothing but zeros", 0.0 * halves, {"packing": "int8"}),
        ("nothing but zeros, partly seen", 0.0 * halves, {"packing": "int8", "hidden": [59]}),
        ("halves of float16 are even", near_halves, {"packing": "float16"}),
        ("subnormal numbers of float16", small, {"packing": "float16", **partial}),
        ("tiny numbers", small * 1e-30, {"packing": "int8"}),
        ("a scale that is subnormal", small * 5.3e-34, {"packing": "int8"}),
        ("numbers below every scale", small * 1.7e-35, {"packing": "int8"}),
    ]
    for name, values, options in cases:
        shown = {"hidden": [], "rings": None, **options}
        packing = shown.pop("packing")
        real = np.asarray(values, np.float32)
        imag = np.concatenate([0.0 * real[:, :1], -real[:, :0:-1]], axis=1) + 0.0
        signature = {
            "segment": None,
            **shown,
            "values_real": real.tolist(),
            "values_imag": imag.tolist(),
        }
        yield _packed(name, packing, [signature])
    paper = [{"segment": segment, "values": near_halves.tolist()} for segment in (0, 65535)]
    yield _packed("two segments", "float16", paper)
    signed = [{"segment": 1, "values": [[-0.0, 0.0], [65503.0, -1.0]]}]
    yield _packed("zeros of both signs", "float16", signed)
    edge = [{"segment": 2, "values": [[1.0, 65510.0], [2.0, 3.0]]}]
    yield _packed("just beyond float16", "float16", edge)
    beyond = [{"segment": 7, "values": (near_halves * 1.25).tolist()}]
    yield _packed("beyond float16", "float16", beyond)


def _packed(name: str, packing: str, signatures: list[Values]) -> Values:
    case = {
        "name": name,
        "basis": _REVISION,
        "packing": Packing(packing).value,
        "signatures": [{"segment": None, "hidden": [], "rings": None, **s} for s in signatures],
    }
    return {**case, "packed": outcomes.packing_outcome(case)}


def answer_cases() -> Iterator[Values]:
    """Yield answers, packed and as JSON."""
    localizer = Localizer(golden_harmonic_map())
    by = Answering(localizer, _REVISION)
    pose = Pose(
        612345.671875, -5412345.25, 117.5, 0.0, 0.0, 0.25881904510252074, 0.9659258262890683
    )
    beside = replace(pose, x_m=612346.7, y_m=-5412344.1)
    best = Match(
        segment=3,
        fraction=0.5,
        along_m=12.25,
        drive="tuesday",
        scan_index=4711,
        row=5,
        distance=0.125,
        timestamp_s=1700000000.5,
        pose=pose,
        relative_yaw_deg=-90.0,
        lateral_m=1.5,
        estimated_pose=beside,
    )
    known = Localization(
        _REVISION,
        (best,),
        replace(best, row=0, scan_index=0, drive="monday", distance=0.25),
        (0, 1, 2, 3),
        Decision(0.9921875, None),
        Deviation(0.75, 0.3, 2.1),
        0.5,
    )
    of_paper = replace(
        best, relative_yaw_deg=None, lateral_m=None, estimated_pose=None, drive="monday"
    )
    yield {"name": "localized", **outcomes.answer_outcome(known, by)}
    yield {
        "name": "an older revision of the paper's encoding",
        **outcomes.answer_outcome(
            replace(known, revision="0123456789abcdef" * 4, matches=(of_paper,)), by
        ),
    }
    for refusal in Refusal:
        refused = replace(known, decision=Decision(0.0625, refusal))
        yield {"name": f"refused: {refusal.value}", **outcomes.answer_outcome(refused, by)}
    bare = replace(of_paper, pose=None, along_m=None, timestamp_s=None)
    nothing = replace(
        known,
        matches=(bare,),
        runner_up=None,
        deviation=None,
        ratio=None,
        decision=Decision(None, None),
    )
    yield {"name": "nothing but a scan", **outcomes.answer_outcome(nothing, by)}
    sure = replace(known, deviation=Deviation(6e-8, 1e-5, 3.3e-5))
    yield {"name": "subnormal deviations", **outcomes.answer_outcome(sure, by)}
    most = replace(best, segment=70_000, scan_index=2**40, distance=1e300)
    large = replace(known, matches=(most,), deviation=Deviation(1e5, 7e4, 0.1))
    yield {"name": "beyond what its fields take", **outcomes.answer_outcome(large, by)}


def _write(path: Path, cases: Iterator[Mapping[str, Any]]) -> None:
    lines = ",\n".join(json.dumps(case, allow_nan=False) for case in cases)
    path.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
