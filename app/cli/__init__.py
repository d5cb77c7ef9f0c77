"""The command line: `tensormap`; commands are siblings of the routes over `app.pipelines`."""

from app.cli.main import main

__all__ = ["main"]
