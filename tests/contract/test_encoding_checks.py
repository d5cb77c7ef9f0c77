"""Code outside of `core.encodings` does not check which encoding it has, by its syntax tree."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]

MAY_NAME = {
    # The forms of a signature on the wire.
    "app/localization/signature_schemas.py": {"paper", "harmonic"},
    # The default of the class whose defaults are the paper's.
    "core/parameters.py": {"paper"},
    # An example of a request.
    "app/builds/parameters.py": {"harmonic"},
}
"""Modules that may name an encoding, and why."""

OTHER_ENCODINGS = "storage/formats/scans/"  # text or binary, as PCD and PLY call them
OURS = ("core.encodings.paper", "core.encodings.harmonic")
CLASSES = {"Encoding", "Model", "Basis", "Search"}


def test_nothing_outside_of_the_encodings_checks_which_one_it_has():
    found = [
        f"{name}:{line}: {what}"
        for room in ("app", "baselines", "core", "storage")
        for path in sorted((ROOT / room).rglob("*.py"))
        if not (name := path.relative_to(ROOT).as_posix()).startswith(
            ("core/encodings/", OTHER_ENCODINGS)
        )
        for line, what in checks(path.read_text(), MAY_NAME.get(name, set()))
    ]
    assert found == []


def test_each_check_of_the_encoding_is_found():
    for code in (
        'name = "harmonic"',
        "from core.encodings.paper import PaperModel",
        "import core.encodings.harmonic.model as h",
        "if parameters.encoding == expected: pass",
        "if encoding is other: pass",
        "{parameters.encoding: 1}",
        "rows[parameters.encoding]",
        "rows.get(parameters.encoding)",
        "isinstance(model, Model | int)",
        "type(basis) is kind",
        "match parameters.encoding:\n  case other: pass",
        "match model:\n  case Model(): pass",
    ):
        assert list(checks(code)), code
    for code in (
        "parameters.encoder.per_segment",
        "build(parameters.encoding)",
        '{"encoding": parameters.encoding}',
        "isinstance(grid, RingGrid)",
    ):
        assert not list(checks(code)), code


def checks(code, may_name=frozenset()):
    """Yield the lines that name an encoding, or choose by one, and how."""
    for node in ast.walk(ast.parse(code)):
        for what in _checks_of(node, may_name):
            yield getattr(node, "lineno", 0), what


def _checks_of(node, may_name):
    match node:
        case ast.Constant(value="paper" | "harmonic" as named) if named not in may_name:
            yield f"names {named}"
        case ast.ImportFrom(module=str() as module) if module.startswith(OURS):
            yield f"imports from {module}"
        case ast.Import(names=names) if any(alias.name.startswith(OURS) for alias in names):
            yield "imports one encoding"
        case ast.Compare():
            yield from _chooses([node.left, *node.comparators])
        case ast.Dict(keys=keys):
            yield from _chooses([key for key in keys if key is not None])
        case ast.Subscript(slice=key):
            yield from _chooses([key])
        case ast.Call(func=ast.Attribute(attr="get"), args=[key, *_]):
            yield from _chooses([key])
        case ast.Call(func=ast.Name(id="isinstance" | "issubclass"), args=[_, kinds]):
            if _names(kinds) & CLASSES:
                yield "checks for a class of an encoding"
        case ast.Match(subject=subject, cases=cases):
            yield from _chooses([subject])
            if any(_names(case.pattern) & CLASSES for case in cases):
                yield "matches a class of an encoding"


def _chooses(values):
    """Yield if one of these values is an encoding, its name or the class of its parts."""
    for value in values:
        match value:
            case ast.Attribute(attr="encoding" | "encoder") | ast.Name(id="encoding" | "encoder"):
                yield "chooses by the encoding"
            case ast.Call(func=ast.Name(id="type"), args=[ast.Name(id="model" | "basis")]):
                yield "chooses by the class"


def _names(tree):
    return {leaf.id for leaf in ast.walk(tree) if isinstance(leaf, ast.Name)}
