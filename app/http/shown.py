"""Models of answers that show an object of the core or of the catalog."""

from typing import Any, Self

from pydantic import BaseModel, ConfigDict


class Shown(BaseModel):
    """A model whose fields are attributes of the object that it shows."""

    model_config = ConfigDict(from_attributes=True)

    @classmethod
    def of(cls, source: object, **other: Any) -> Self:  # noqa: ANN401 - what the fields take
        """Return the model with the attributes of `source`, except the given fields."""
        names = cls.model_fields.keys() - other.keys()
        return cls(**{name: getattr(source, name) for name in names}, **other)


def is_none(value: object) -> bool:
    """Return whether a value is none: for `exclude_if` of a field that is left out then."""
    return value is None
