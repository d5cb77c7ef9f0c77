"""`python -m benchmarks`: every measurement, each against its bar."""

import subprocess
import sys

_ALL = (
    "fit_segment",
    "localize",
    "match_harmonic",
    "match_scan",
    "answer_overhead",
    "http_answers",
    "build_memory",
    "open_revision",
)


def main() -> int:
    """Run each benchmark in a process of its own and return how many missed their bar."""
    missed = [
        name for name in _ALL if subprocess.call([sys.executable, "-m", f"benchmarks.{name}"])
    ]
    if missed:
        print(f"below the bar: {', '.join(missed)}")
    return len(missed)


if __name__ == "__main__":
    sys.exit(main())
