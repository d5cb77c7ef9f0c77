"""The service's settings for a command: its options override the environment.

The administrator's key is not in the environment afterwards: processes that a command starts read
files of others, and need no key.
"""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from app.http.field_problems import wanted_and_got
from app.process import forget_variable
from app.settings import ADMIN_KEY, Settings
from core.errors import InvalidParameters

_SECRET = {"admin_key", "catalog_url"}


def chosen_settings(**chosen: Any) -> Settings:  # noqa: ANN401 - each setting checks its own type
    """Return the settings of the environment, overridden by the options that are not `None`.

    Raises:
        InvalidParameters: If one is wrong; the error does not contain a key or a password.
    """
    try:
        settings = Settings(**{name: value for name, value in chosen.items() if value is not None})
    except ValidationError as error:
        raise InvalidParameters("; ".join(map(_named, error.errors()))) from None
    forget_variable(ADMIN_KEY)
    return settings


def _named(fault: Mapping[str, Any]) -> str:
    """Return what is wrong with a setting, by its name in the environment."""
    name = str(fault["loc"][0])
    if name in _SECRET:
        fault = {part: value for part, value in fault.items() if part != "input"}
    return f"TENSORMAP_{name.upper()}: {wanted_and_got(fault)}"
