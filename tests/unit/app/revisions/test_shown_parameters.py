"""The parameters of a basis are described as they are sent."""

from typing import Any

import pytest
from pydantic import TypeAdapter

from app.revisions.schemas import BasisOut
from app.revisions.shown_parameters import ShownParameters
from core.parameters import MapParameters, Segmentation
from core.projection.imager import ImageKind

DESCRIBED = TypeAdapter(ShownParameters).json_schema()
_TYPES = {"string": str, "number": float, "integer": int, "boolean": bool, "array": list}


def _require_described(sent: dict[str, Any], schema: dict[str, Any]) -> None:
    assert set(schema["required"]) <= set(sent) <= set(schema["properties"])
    for name, value in sent.items():
        described = schema["properties"][name]
        if name != "grid":
            assert type(value) is _TYPES[described["type"]], name
            assert value in described.get("enum", [value])


@pytest.mark.parametrize(
    "parameters",
    [
        MapParameters.for_sensor(),
        MapParameters.for_sensor(encoding="paper", segmentation=Segmentation.UNEQUAL),
        MapParameters.for_sensor(image=ImageKind.RANGE, lateral_renderings_m=(-2.0, 2.0)),
        MapParameters.for_sensor(segmentation=Segmentation.UNEQUAL),
    ],
    ids=["any views", "paper", "ranges", "unequal"],
)
def test_all_that_is_sent_is_described_and_what_is_required_is_sent(
    parameters: MapParameters,
) -> None:
    sent = parameters.as_attributes()
    _require_described(sent, DESCRIBED)
    kinds = DESCRIBED["properties"]["grid"]["anyOf"]
    [grid] = [kind for kind in kinds if set(kind["properties"]) == set(sent["grid"])]
    _require_described(sent["grid"], grid)


def test_each_described_parameter_is_one_that_a_map_sends() -> None:
    of_maps = (
        MapParameters.for_sensor(segmentation=Segmentation.UNEQUAL),
        MapParameters.for_sensor(image=ImageKind.RANGE),
    )
    assert set(DESCRIBED["properties"]) == {name for one in of_maps for name in one.as_attributes()}


def test_what_a_basis_has_always_is_required_though_it_may_be_null() -> None:
    schema = BasisOut.model_json_schema()
    assert set(schema["required"]) == set(schema["properties"])
