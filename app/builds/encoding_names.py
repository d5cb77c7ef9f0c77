"""Names of encodings in requests: those that are registered at the time of the request."""

from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from core.encodings.registry import encoding_names


class _Registered:
    """Makes `str` a choice like an enum, also in OpenAPI, that registering extends."""

    def __get_pydantic_core_schema__(
        self, source: type[str], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_after_validator_function(
            _known, handler(source), ref="core.encodings.Encoding"
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        named = handler(schema)
        handler.resolve_ref_schema(named).update(
            {
                "description": "How images become signatures.",
                "enum": list(encoding_names()),
                "title": "Encoding",
                "type": "string",
            }
        )
        return named


def _known(name: Any) -> str:  # noqa: ANN401 - pydantic gives what it validated
    names = encoding_names()
    if name not in names:
        listed = [repr(known) for known in names]
        raise PydanticKnownError("enum", {"expected": f"{', '.join(listed[:-1])} or {listed[-1]}"})
    return str(name)


EncodingName = Annotated[str, _Registered()]
