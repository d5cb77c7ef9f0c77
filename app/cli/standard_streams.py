"""Standard output and error of a command: closed, full, or of an encoding that lacks characters."""

import io
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO


class UnfailingStream:
    """A text stream that drops what cannot be written, as on a full disk or without a reader."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text if possible; return its length."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Pass on what is held, if possible."""
        with suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - the other attributes of the stream
        return getattr(self._stream, name)


def prepare_streams() -> None:
    """Let a command do its work whatever its caller made of its outputs.

    A closed one goes nowhere: its number would also go to the next file that is opened, such as a
    map. Progress and notes that cannot be written do not end the work that they are about; results
    that cannot be are an error.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, nowhere())
    _show_any_name()
    sys.stderr = UnfailingStream(sys.stderr)


def _show_any_name() -> None:
    """Show characters that the output's encoding lacks as escapes; by default they are an error.

    Names of files and drives have any, and what they are printed for is done by then.
    """
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def nowhere() -> TextIO:
    """Return a stream of which nothing is read."""
    return Path(os.devnull).open("w", encoding="utf-8")
