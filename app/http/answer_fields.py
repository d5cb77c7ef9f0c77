"""The fields of an answer that a request asks for."""

from typing import Any

from pydantic import AfterValidator, BaseModel

MOST_FIELDS_CHARACTERS = 1000
"""Longest value of a parameter `fields`."""


def known_fields(answer: type[BaseModel]) -> AfterValidator:
    """Return the check of a parameter `fields`, see `included`."""

    def checked(fields: str) -> str:
        included(fields, answer)
        return fields

    return AfterValidator(checked)


def included(fields: str, answer: type[BaseModel]) -> dict[str, Any]:
    """Return `fields` as pydantic's `include`.

    Args:
        fields: Names separated by commas, those of nested fields after a dot.
        answer: The model that they are of.

    Raises:
        ValueError: If one is no field of an answer.

    Examples:
        >>> class Pose(BaseModel):
        ...     x_m: float
        >>> class Answer(BaseModel):
        ...     localized: bool
        ...     pose: Pose
        >>> included("localized,pose.x_m", Answer)
        {'localized': True, 'pose': {'x_m': True}}
    """
    include: dict[str, Any] = {}
    for field in fields.split(","):
        names, at = field.strip().split("."), include
        model: type[BaseModel] | None = answer
        for depth, name in enumerate(names):
            if model is None or name not in model.model_fields:
                holder = ".".join(names[:depth])[:80] or "it"
                held = "no fields" if model is None else ", ".join(model.model_fields)
                raise ValueError(f"an answer has no field {field[:80]!r}, {holder} has {held}")
            nested, many = _nested(model.model_fields[name].annotation)
            if depth == len(names) - 1:
                at[name] = True
                break
            if at.get(name) is True:
                break  # all of it is included already
            at = at.setdefault(name, {})
            if many:
                at = at.setdefault("__all__", {})
            model = nested
    return include


def _nested(annotation: Any) -> tuple[type[BaseModel] | None, bool]:  # noqa: ANN401 - a type
    """Return the model within a field's type, and whether the field is a list of them."""
    kinds = (annotation, *getattr(annotation, "__args__", ()))
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return (models[0] if models else None), getattr(annotation, "__origin__", None) is list
