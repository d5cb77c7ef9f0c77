"""The OpenAPI document, completed where FastAPI does not describe our routes."""

import re
from typing import Any

from fastapi import FastAPI
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from app.http.answer_headers import describe_heads

_named: set[type[BaseModel]] = set()
_NOT_OURS = ("HTTPValidationError", "ValidationError")


def reference(model: type[BaseModel]) -> dict[str, str]:
    """Return a reference to a model's schema, and add that to the document."""
    _named.add(model)
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def complete_openapi(app: FastAPI) -> None:
    """Add the schemas of `reference`, and remove FastAPI's own 422, which we never answer."""
    described = app.openapi

    def complete() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = described()
            schemas = document["components"]["schemas"]
            _, ours = models_json_schema(
                [(model, "validation") for model in _named],
                ref_template="#/components/schemas/{model}",
            )
            schemas.update(ours["$defs"])
            for name in _NOT_OURS:
                schemas.pop(name, None)
            for path in document["paths"].values():
                for operation in path.values():
                    _drop_foreign_422(operation["responses"])
                    describe_heads(operation)
                    _list_scopes_as_alternatives(operation)
                    _drop_null(operation)
                    _summarize(operation)
            for schema in schemas.values():
                _drop_null_defaults(schema)
        return app.openapi_schema or {}

    # FastAPI's documented way to extend the document.
    app.openapi = complete  # type: ignore[method-assign]


def _list_scopes_as_alternatives(operation: dict[str, Any]) -> None:
    # FastAPI lists a route's scopes as if all were needed; our routes need one of them.
    if security := operation.get("security"):
        [(scheme, scopes)] = security[0].items()
        operation["security"] = [{scheme: [scope]} for scope in scopes]


def _summarize(operation: dict[str, Any]) -> None:
    # FastAPI's summary is the name of a function.
    first = re.split(r"[.;]\s|\.$", operation["description"], maxsplit=1)[0]
    operation["summary"] = " ".join(first.replace("`", "").split())  # it is shown as it is


def _drop_null(operation: dict[str, Any]) -> None:
    # Optional parameters are left out: no text in a path, query or header is null.
    for parameter in operation.get("parameters", ()):
        schema = parameter["schema"]
        kinds = [kind for kind in schema.get("anyOf", ()) if kind != {"type": "null"}]
        if len(kinds) == 1:
            del schema["anyOf"]
            parameter["schema"] = {**kinds[0], **schema}


def _drop_null_defaults(schema: dict[str, Any]) -> None:
    # Without it a field is left out. Generated clients send defaults, and a null removes a scan's
    # pose, a map's anchor and its own retention, which stay if nothing is sent.
    for field in schema.get("properties", {}).values():
        if field.get("default", ...) is None:
            del field["default"]


def _drop_foreign_422(responses: dict[str, Any]) -> None:
    content = responses.get("422", {}).get("content", {})
    schema = content.get("application/json", {}).get("schema", {})
    if schema.get("$ref", "").endswith(_NOT_OURS):
        del responses["422"]
