"""The service's own code gives the outcomes of the conformance kit."""

import json
from collections.abc import Mapping
from typing import Any

import pytest

from core.encodings.signature import unpack_signatures
from tests.vectors import make, outcomes

SIGNATURES, PLANES, PACKINGS, ANSWERS = (
    json.loads((outcomes.FOLDER / f"{name}.json").read_text())
    for name in ("signatures", "planes", "packing", "answers")
)
BASES = {
    path.stem: outcomes.basis_of(json.loads(path.read_text()))
    for path in sorted((outcomes.FOLDER / "bases").glob("*.json"))
}


def require_same(found: Any, kept: Any, where: str) -> None:
    """Numbers of signatures may differ in the last digit: BLAS adds in an order of its own."""
    if isinstance(kept, Mapping):
        for name, value in kept.items():
            require_same(found[name], value, f"{where}.{name}")
    elif "values" in where:
        largest = max(abs(number) for row in kept for number in row)
        for row, kept_row in zip(found, kept, strict=True):
            assert row == pytest.approx(kept_row, rel=1e-6, abs=1e-9 * largest), where
    elif isinstance(kept, list):
        assert len(found) == len(kept), where
        for number, (one, other) in enumerate(zip(found, kept, strict=True)):
            require_same(one, other, f"{where}[{number}]")
    else:
        assert found == kept, where


@pytest.mark.parametrize("case", SIGNATURES, ids=lambda case: f"{case['scan']}-{case['basis']}")
def test_a_scan_becomes_the_signature_of_the_kit(case: dict[str, Any]) -> None:
    require_same(outcomes.signature_outcome(case, BASES[case["basis"]]), outcome_of(case), "case")


def outcome_of(case: dict[str, Any]) -> dict[str, Any]:
    given = {"scan", "basis", "sensor_height_m", "roll_deg", "pitch_deg"}
    return {name: value for name, value in case.items() if name not in given}


def test_planes_of_the_ground_are_those_of_the_kit() -> None:
    assert [outcomes.plane_outcome(case) for case in PLANES] == [case["plane"] for case in PLANES]
    assert {case["plane"] is None for case in PLANES} == {False, True}


@pytest.mark.parametrize("case", PACKINGS, ids=lambda case: case["name"])
def test_numbers_are_packed_as_in_the_kit_and_read_again(case: dict[str, Any]) -> None:
    assert outcomes.packing_outcome(case) == case["packed"]
    read = unpack_signatures(bytes.fromhex(case["packed"]))
    for signature, values in zip(read, case["signatures"], strict=True):
        found = outcomes.plain(signature)
        assert found["segment"] == values["segment"]
        assert (found["hidden"], found["rings"]) == (values["hidden"], values["rings"])


@pytest.mark.parametrize("name", [case["name"] for case in ANSWERS])
def test_an_answer_says_what_the_kit_says(name: str) -> None:
    [kept] = [case for case in ANSWERS if case["name"] == name]
    [made] = [case for case in make.answer_cases() if case["name"] == name]
    require_same(json.loads(json.dumps(made)), kept, name)
    assert outcomes.decoded(bytes.fromhex(kept["packed"])) == kept["decoded"]


def test_the_kit_has_every_layout_and_every_kind_of_image_and_reducer() -> None:
    bodies = [bytes.fromhex(body) for case in SIGNATURES for body in packed(case)]
    assert {body[0] for body in bodies} == {1, 2, 3, 4, 5, 6}
    parameters = [basis.parameters for basis in BASES.values()]
    assert {(p.encoding, p.image.value) for p in parameters} == {
        ("paper", "range"),
        ("harmonic", "range"),
        ("harmonic", "height"),
    }
    assert {p.reducer.value for p in parameters} == {
        *("last", "nearest", "farthest", "mean", "highest")
    }
    assert {p.views.value for p in parameters} == {"any", "full"}


def packed(case: dict[str, Any]) -> list[str]:
    return [] if case["refused"] else [body for body in case["packed"].values() if body]
