"""The command line: `tensormap`."""

from app.cli.main import main

__all__ = ["main"]
