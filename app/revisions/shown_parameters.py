"""The parameters of a basis, as the API describes them; they are sent as the map has them."""

from enum import StrEnum
from typing import Annotated, Any

from pydantic import TypeAdapter, WithJsonSchema

from core.encodings.distance import Distance
from core.encodings.registry import encoding_names
from core.parameters import Segmentation
from core.projection.imager import ImageKind, Views
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.sensor import AngularGrid


def _grid(kind: type[AngularGrid] | type[RingGrid], description: str) -> dict[str, Any]:
    properties = {
        name: {"type": schema["type"]}
        for name, schema in TypeAdapter(kind).json_schema()["properties"].items()
    }
    return {
        "type": "object",
        "description": description,
        "properties": properties,
        "required": list(properties),
    }


def _one_of(values: type[StrEnum], description: str) -> dict[str, Any]:
    return {"type": "string", "enum": [value.value for value in values], "description": description}


_ALWAYS: dict[str, Any] = {
    "encoding": {
        "type": "string",
        "description": f"How images become signatures: {' or '.join(sorted(encoding_names()))}.",
    },
    "ranks": {
        "type": "array",
        "items": {"type": "integer", "minimum": 1},
        "minItems": 2,
        "maxItems": 2,
        "description": "r1 and r2 of the signatures that vehicles send by default.",
    },
    "reducer": _one_of(Reducer, "Which of several returns in one cell counts."),
    "sensor": {"type": "string", "description": "Name of the sensor that recorded the drives."},
    "grid": {
        "anyOf": [
            _grid(AngularGrid, "Elevations by azimuths, of range images."),
            _grid(RingGrid, "Rings by azimuths, of height images."),
        ],
        "description": "The cells of an image.",
    },
    "sensor_height_m": {"type": "number", "description": "Of the sensor above the ground."},
}
_SOMETIMES: dict[str, Any] = {
    "image": _one_of(ImageKind, "The image's kind; not of the paper's encoding."),
    "distance": _one_of(Distance, "How signatures are compared; not of the paper's encoding."),
    "lateral_renderings_m": {
        "type": "array",
        "items": {"type": "number"},
        "description": "The virtual viewpoints, metres to the left; not of the paper's encoding.",
    },
    "segmentation": _one_of(Segmentation, "How drives were cut into segments; `fixed` without."),
    "views": _one_of(Views, "Which views the map answers; `full` without."),
    "verification_images": {
        "type": "boolean",
        "description": "Whether the map has verification images; none without.",
    },
}

ShownParameters = Annotated[
    dict[str, Any],
    WithJsonSchema(
        {
            "type": "object",
            "properties": _ALWAYS | _SOMETIMES,
            "required": list(_ALWAYS),
        }
    ),
]
"""Plain values, as `MapParameters.as_attributes` returns them."""
