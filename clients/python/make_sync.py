"""Makes `tensormap_client/_sync` of `tensormap_client/_async`: the same without `await`."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent / "tensormap_client"
_RUFF = str(Path(sys.executable).with_name("ruff"))  # by Python it takes twice as long
_WORDS = [
    (r"\basync (def|with|for)\b", r"\1"),
    (r"\bawait ", ""),
    (r"\bAwaitable\[(\w+)\]", r"\1"),
    (r"\bAwaitable, ", ""),
    (r"\bAsync([A-Z])", r"\1"),
    (r"\b__a(enter|exit)__\b", r"__\1__"),
    (r"\baclose\b", "close"),
    (r"\bio_async\b", "io_sync"),
    (r"\b_async\b", "_sync"),
    (r"\A", "# Made by make_sync.py: change _async instead.\n"),
]


def sync_files() -> Iterator[tuple[Path, str]]:
    """Yield the path and text of each synchronous module."""
    for path in sorted((PACKAGE / "_async").glob("*.py")):
        text = path.read_text(encoding="utf-8")
        for pattern, replacement in _WORDS:
            text = re.sub(pattern, replacement, text)
        to = PACKAGE / "_sync" / path.name
        for command in (["check", "--quiet", "--select", "I", "--fix"], ["format"]):
            words = [_RUFF, *command, "--stdin-filename", str(to), "-"]
            text = subprocess.run(  # noqa: S603 - the linter of this environment
                words, input=text, capture_output=True, check=True, encoding="utf-8"
            ).stdout
        yield to, text


if __name__ == "__main__":
    for path, text in sync_files():
        path.write_text(text, encoding="utf-8")
