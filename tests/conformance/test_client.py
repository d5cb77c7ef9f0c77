"""The Python client gives the outcomes of the conformance kit."""

import json
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tensormap_client import Basis, Tilt, TooFewCells, UnusableScan
from tensormap_client.signature.images import returns
from tensormap_client.signature.levelling import ground, level, rotated

from tests.vectors import outcomes

CASES = json.loads((outcomes.FOLDER / "signatures.json").read_text())


def basis_named(name: str) -> Basis:
    answer = json.loads((outcomes.FOLDER / "bases" / f"{name}.json").read_text())
    arrays = {"radial_basis": np.array(answer.get("radial_basis") or (), np.float32)}
    if answer["segments"]:
        arrays = {"segments": np.array([segment["segment"] for segment in answer["segments"]])}
        for array in ("elevation_basis", "azimuth_basis"):
            arrays[array] = np.array([one[array] for one in answer["segments"]], np.float32)
    return Basis(answer["basis"], answer["parameters"], arrays)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case['scan']}-{case['basis']}")
def test_a_scan_becomes_the_bytes_of_the_kit(case: dict[str, Any]) -> None:
    basis, height_m = basis_named(case["basis"]), case["sensor_height_m"]
    points = np.fromfile(outcomes.FOLDER / f"scans/{case['scan']}.bin", "<f4").reshape(-1, 4)
    angles = case["roll_deg"], case["pitch_deg"]
    tilt = None if None in angles else Tilt(*angles)
    if case["refused"]:
        with pytest.raises(UnusableScan):
            basis.encode(points, sensor_height_m=height_m, tilt=tilt)
        return
    xyz_m = returns(points)
    assert xyz_m.shape[1] == case["returns"]
    if tilt is not None:
        xyz_m = returns(rotated(xyz_m, *angles).T)
    if basis.parameters.get("views") == "any":
        plane = ground(xyz_m, height_m)
        assert (plane and [plane.a, plane.b, plane.offset_m]) == case["plane"]
        xyz_m = level(xyz_m, height_m, is_level=tilt is not None)
    assert f"{zlib.crc32(xyz_m.T.tobytes()):08x}" == case["levelled_crc32"]
    packed = basis.encode(points, sensor_height_m=height_m, tilt=tilt).hex()
    assert packed == case["packed"].get("int8", case["packed"]["float16"])
    enough, more = (replace(basis, least_cells=case["occupied_cells"] + by) for by in (0, 1))
    assert enough.encode(points, sensor_height_m=height_m, tilt=tilt).hex() == packed
    with pytest.raises(TooFewCells):
        more.encode(points, sensor_height_m=height_m, tilt=tilt)
