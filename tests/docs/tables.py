"""The documents' tables, made of the code.

`python -m tests.docs.tables` writes them anew; with `--check` it fails if one is out of date.
"""

import ast
import inspect
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import typer.main
from pydantic_core import PydanticUndefined

from app.cli.main import cli
from app.http.errors import STATUS
from app.http.problems import problem_name
from app.localization.query_schemas import PriorsIn
from app.main import create_app
from app.settings import Settings
from core.scans.sensor import SENSORS
from storage.formats.scans.registry import SCAN_FORMATS

ROOT = Path(__file__).parents[2]
_METHODS = ("get", "post", "put", "patch", "delete")


def settings_table() -> Iterator[str]:
    meanings = _docstrings_of_fields(Settings)
    yield "| variable | default | meaning |"
    yield "|---|---|---|"
    for name, field in Settings.model_fields.items():
        default = "" if field.default in (None, PydanticUndefined, ()) else f"`{field.default}`"
        yield f"| `TENSORMAP_{name.upper()}` | {default} | {meanings[name]} |"


def _docstrings_of_fields(of: type) -> dict[str, str]:
    """Return what is written below each field of a class, on one line.

    Pydantic would read it from the source as well, but at each start of a service.
    """
    [defined] = ast.parse(inspect.getsource(of)).body
    assert isinstance(defined, ast.ClassDef)
    return {
        field.target.id: " ".join(below.value.value.split())
        for field, below in pairwise(defined.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
        if isinstance(below.value.value, str)
    }


@dataclass(frozen=True)
class _Common:
    """Statuses that every route of a kind may answer with, and what they mean."""

    of: str
    meanings: dict[str, str]
    applies: Callable[[str, str, dict[str, object]], bool]


_COMMON = (
    _Common(
        "every route below `/v1`",
        {
            "401": "no key, or a key that is not valid",
            "403": "the key does not allow this",
            "421": "a request to a service without keys under a foreign name, from a proxy or"
            " another site",
            "422": "a parameter or a field of the body that does not match its description",
            "429": "the key sends, or has open or stored, more than it may",
            "500": "an error of the service, or a damaged file",
            "503": "the service has too much to do, is stopping, or its storage fails",
        },
        lambda path, method, shown: path.startswith("/v1/"),
    ),
    _Common(
        "those with a name in the path",
        {"404": "it does not exist, or the key may not see it"},
        lambda path, method, shown: path.startswith("/v1/") and "{" in path,
    ),
    _Common(
        "those that take a body",
        {
            "400": "the body does not decompress, or does not match its `Content-Digest`",
            "408": "the body arrives too slowly",
            "413": "the body is too large",
            "415": "the route does not take this `Content-Type` or `Content-Encoding`",
        },
        lambda path, method, shown: "requestBody" in shown,
    ),
    _Common(
        "`POST`, `PUT`, `PATCH` and `DELETE`",
        {"507": "no space or quota is left on the disk"},
        lambda path, method, shown: path.startswith("/v1/") and method != "get",
    ),
)


def statuses_table() -> Iterator[str]:
    yield "| routes | status | meaning |"
    yield "|---|---|---|"
    for common in _COMMON:
        for status, meaning in common.meanings.items():
            yield f"| {common.of} | {status} | {meaning} |"


def routes_table() -> Iterator[str]:
    """Yield the routes, each without the statuses that are common to its kind.

    Raises:
        ValueError: If a route does not declare a status that is common to its kind.
    """
    yield "| route | what it does | answers |"
    yield "|---|---|---|"
    for path, operations in create_app(Settings(_env_file=None)).openapi()["paths"].items():
        for method in _METHODS:
            if method not in operations:
                continue
            shown = operations[method]
            route = f"`{method.upper()} {path}`"
            does = shown["description"].split("\n")[0]
            common = {
                status
                for kind in _COMMON
                if kind.applies(path, method, shown)
                for status in kind.meanings
            }
            if missing := sorted(common - set(shown["responses"])):
                raise ValueError(f"{route} does not declare {', '.join(missing)}")
            answers = ", ".join(sorted(set(shown["responses"]) - common))
            yield f"| {route} | {does} | {answers} |"


_BOUNDS = (
    ("exclusiveMinimum", "above"),
    ("minimum", "at least"),
    ("exclusiveMaximum", "below"),
    ("maximum", "at most"),
)
_MOST_OF_ANY = 2**31 - 1
"""A bound of the type, not of the parameter."""


def _values(shown: dict[str, Any], of: dict[str, Any]) -> str:
    """Return which values a parameter of the OpenAPI document may have."""
    choices = [one for one in shown.get("anyOf", [shown]) if one.get("type") != "null"]
    choice = {**shown, **choices[0]}
    if "$ref" in choice:
        choice |= of[choice["$ref"].rpartition("/")[2]]
    if "enum" in choice:
        return ", ".join(f"`{value}`" for value in choice["enum"])
    if choice["type"] == "boolean":
        return "`true`, `false`"
    if choice["type"] == "array":
        exactly = choice.get("minItems") == choice["maxItems"]
        return f"list of {'' if exactly else 'at most '}{choice['maxItems']:,}"
    bounds = [
        f"{word} {choice[name]:,g}"
        for name, word in _BOUNDS
        if name in choice and choice[name] != _MOST_OF_ANY
    ]
    return ", ".join([choice["type"], *bounds])


def _parameters(named: Mapping[str, dict[str, Any]], of: dict[str, Any]) -> Iterator[str]:
    yield "| name | values | default | meaning |"
    yield "|---|---|---|---|"
    for name, shown in named.items():
        default = shown.get("default")
        written = "" if default is None else f"`{json.dumps(default).strip(chr(34))}`"
        yield f"| `{name}` | {_values(shown, of)} | {written} | {shown['description']} |"


def build_table() -> Iterator[str]:
    """Yield the parameters of a build; not those that only earlier releases had."""
    schemas = create_app(Settings(_env_file=None)).openapi()["components"]["schemas"]
    shown = schemas["BuildParameters"]["properties"]
    yield from _parameters(
        {name: one for name, one in shown.items() if not one.get("deprecated")}, schemas
    )


def query_table() -> Iterator[str]:
    """Yield the query parameters of the localization of a scan, without the priors."""
    described = create_app(Settings(_env_file=None)).openapi()
    route = described["paths"]["/v1/maps/{map}/localizations/scan"]["post"]
    shown = {
        one["name"]: {**one["schema"], "description": one["description"]}
        for one in route["parameters"]
        if one["in"] == "query" and one["name"] not in PriorsIn.model_fields
    }
    yield from _parameters(shown, described["components"]["schemas"])


def problems_table() -> Iterator[str]:
    yield "| type | status | meaning |"
    yield "|---|---|---|"
    for kind, status in STATUS.items():
        meaning = (kind.__doc__ or "").strip().splitlines()[0]
        yield f"| `/problems/{problem_name(kind)}` | {status.value} | {meaning} |"


def commands_table() -> Iterator[str]:
    yield "| command | what it does |"
    yield "|---|---|"
    group = cast("typer.core.TyperGroup", typer.main.get_command(cli))
    context = typer.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        meaning = ((command and command.help) or "").strip().split("\n")[0]
        yield f"| `tensormap {name}` | {meaning} |"


def formats_table() -> Iterator[str]:
    yield "| format | `Content-Type` | files | detected by its first bytes |"
    yield "|---|---|---|---|"
    for known in SCAN_FORMATS:
        suffixes = " ".join(f"`{suffix}`" for suffix in known.suffixes)
        answer = "yes" if known.magics else ""
        yield f"| {known.name} | `{known.media_type}` | {suffixes} | {answer} |"


def sensors_table() -> Iterator[str]:
    yield "| sensor | beams | elevation, deg | azimuth, deg | rays in 0.1 s | source |"
    yield "|---|---|---|---|---|---|"
    for sensor in SENSORS.values():
        beams = len(sensor.beams_deg) if sensor.repeats else ""
        lowest, highest = sensor.beams_deg[[0, -1]]
        yield (
            f"| `{sensor.name}` | {beams} | {lowest:.4g} to {highest:.4g} | {sensor.fov_deg:g} |"
            f" {sensor.rays_per_scan} | {sensor.source} |"
        )


def client_problems() -> Iterator[str]:
    """Yield the client's error classes, each below the one that it is in the service."""
    yield '"""The types of the service\'s problems, as errors; made by `tests.docs.tables`."""'
    yield ""
    yield "from tensormap_client.errors import Rejected"
    ordered = sorted(STATUS, key=lambda kind: len(kind.__mro__))  # bases first, else as they are
    for kind in ordered:
        parent = next((base for base in kind.__mro__[1:] if base in STATUS), None)
        meaning = (kind.__doc__ or "").strip().splitlines()[0]
        yield ""
        yield ""
        yield f"class {kind.__name__}({'Rejected' if parent is None else parent.__name__}):"
        yield f'    """{meaning}"""'
        yield ""
        yield f'    problem = "{problem_name(kind)}"'
        yield f"    usual_status = {STATUS[kind].value}"
    yield ""
    yield ""
    yield "PROBLEMS: dict[str, type[Rejected]] = {"
    yield from (f"    {kind.__name__}.problem: {kind.__name__}," for kind in ordered)
    yield "}"


CLIENT_PROBLEMS = ROOT / "clients/python/tensormap_client/problems.py"

TABLES: dict[str, tuple[Path, Callable[[], Iterator[str]]]] = {
    "settings": (ROOT / "docs/how-to/run-the-service.md", settings_table),
    "statuses": (ROOT / "docs/reference/http-api.md", statuses_table),
    "routes": (ROOT / "docs/reference/http-api.md", routes_table),
    "build": (ROOT / "docs/reference/http-api.md", build_table),
    "query": (ROOT / "docs/reference/http-api.md", query_table),
    "problems": (ROOT / "docs/reference/http-api.md", problems_table),
    "formats": (ROOT / "docs/reference/formats.md", formats_table),
    "sensors": (ROOT / "docs/reference/sensors.md", sensors_table),
    "commands": (ROOT / "docs/reference/cli.md", commands_table),
}


def with_table(name: str) -> tuple[str, str]:
    """Return a document as it is, and as it is with the table of the code."""
    path, make = TABLES[name]
    text = path.read_text()
    begin, end = f"<!-- table: {name} -->\n", f"<!-- end of table: {name} -->"
    if begin not in text or end not in text:
        raise ValueError(f"{path} has no place for table {name}")
    table = "\n".join(make())
    expected = re.sub(
        re.escape(begin) + ".*?" + re.escape(end),
        lambda _: f"{begin}\n{table}\n\n{end}",
        text,
        flags=re.DOTALL,
    )
    return text, expected


if __name__ == "__main__":
    for name, (path, _) in TABLES.items():
        found, expected = with_table(name)
        if "--check" in sys.argv:
            sys.exit(f"{path} is out of date") if found != expected else None
        else:
            path.write_text(expected)
    classes = "\n".join([*client_problems(), ""])
    if "--check" not in sys.argv:
        CLIENT_PROBLEMS.write_text(classes)
    elif CLIENT_PROBLEMS.read_text() != classes:
        sys.exit(f"{CLIENT_PROBLEMS} is out of date")
