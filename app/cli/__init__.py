"""The command line: `tensormap`."""

import sys

try:
    from app.cli.main import main
except KeyboardInterrupt:  # imports take a while
    sys.exit(130)

__all__ = ["main"]
