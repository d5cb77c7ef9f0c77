"""Paths of the repository and metrics that a document, docstring or comment names exist."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = (
    *("app", "baselines", "benchmarks", "clients", "core", "deploy", "docs", "examples"),
    *("storage", "tests", "tools"),
)
TEXTS = [
    *ROOT.glob("*.md"),
    *(
        path
        for folder in FOLDERS
        for kind in ("md", "py")
        for path in (ROOT / folder).rglob(f"*.{kind}")
    ),
]
SERVICE = [path for folder in ("app", "storage") for path in (ROOT / folder).rglob("*.py")]

_PATH = re.compile(rf"(?<![\w./-])((?:{'|'.join(FOLDERS)})/[\w./<>*{{}}-]*\w)(?:::(\w+))?")
_PATTERN = re.compile(r"[<*{]")  # `tests/unit/<folder>/...` is of several paths
_METRIC = re.compile(r"(?<![\w.])tensormap_\w+(?![\w(])")  # no attribute and no function
_ADDED = re.compile(r"_(total|created|sum|count|bucket)$")  # to a metric's name, by Prometheus
DISTRIBUTIONS = {"tensormap_client", "tensormap_server"}


def found(pattern: re.Pattern[str]) -> Iterator[tuple[str, re.Match[str]]]:
    """Yield each match in the repository's texts, after where it is."""
    for path in sorted(TEXTS):
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            for match in pattern.finditer(line):
                yield f"{path.relative_to(ROOT)}:{number}", match


def test_every_path_that_is_named_exists() -> None:
    dead = []
    for where, match in found(_PATH):
        path, test = ROOT / match[1], match[2]
        if _PATTERN.search(match[1]):
            continue
        if not path.exists() or (test and f"def {test}(" not in path.read_text()):
            dead.append(f"{where} names {match[0]}")
    assert not dead, "\n".join(dead)


def test_every_metric_that_is_named_is_one_of_the_service() -> None:
    """Or another name that its code gives, as that of a context variable."""
    given = {
        name for path in SERVICE for name in re.findall(r'"(tensormap_\w+)"', path.read_text())
    }
    dead = [
        f"{where} names {match[0]}"
        for where, match in found(_METRIC)
        if not {match[0], _ADDED.sub("", match[0])} & (given | DISTRIBUTIONS)
    ]
    assert not dead, "\n".join(dead)
