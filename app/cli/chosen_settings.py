"""The service's settings for a command: its options override the environment."""

from typing import Any

from pydantic import ValidationError

from app.http.field_problems import wanted_and_got
from app.settings import Settings
from core.errors import InvalidParameters


def chosen_settings(**chosen: Any) -> Settings:  # noqa: ANN401 - each setting checks its own type
    """Return the settings of the environment, overridden by the options that are not `None`.

    Raises:
        InvalidParameters: If one is wrong; the error does not contain its value.
    """
    try:
        return Settings(**{name: value for name, value in chosen.items() if value is not None})
    except ValidationError as error:
        faults = error.errors(include_input=False)  # it may be a key
        raise InvalidParameters(
            "; ".join(
                f"TENSORMAP_{str(one['loc'][0]).upper()}: {wanted_and_got(one)}" for one in faults
            )
        ) from None
