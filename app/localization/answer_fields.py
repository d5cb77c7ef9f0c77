"""The fields of an answer that a request asks for."""

from typing import Any

from pydantic import BaseModel

from app.localization.schemas import LocalizationOut


def included(fields: str) -> dict[str, Any]:
    """Return `fields` as pydantic's `include`.

    Raises:
        ValueError: If one is no field of an answer.

    Examples:
        >>> included("localized,best.drive,best.pose")
        {'localized': True, 'best': {'drive': True, 'pose': True}}
    """
    include: dict[str, Any] = {}
    for field in fields.split(","):
        names, at = field.strip().split("."), include
        model: type[BaseModel] | None = LocalizationOut
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
