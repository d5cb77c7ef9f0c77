"""How much of each attack is run, and by which seed; both come from the environment.

`TENSORMAP_TORTURE_KILLS=300` and so on; what is not given is what `.ci/run` can afford, and
`make torture` gives the long ones. A failure is repeated with the seed that the run printed.
"""

import os
import random
import time
from pathlib import Path

_PREFIX = "TENSORMAP_TORTURE_"

SEED = int(os.environ.get(f"{_PREFIX}SEED") or time.time_ns() % 1_000_000)
"""The seed of this run."""
os.environ[f"{_PREFIX}SEED"] = str(SEED)  # the workers that share the tests out have it too

OWN_TREE = Path(__file__).parents[3]
"""This checkout."""
TREE = Path(os.environ.get(f"{_PREFIX}TREE") or OWN_TREE)
"""The checkout whose service is attacked; this one by default."""


def size(name: str, default: int) -> int:
    """Return how many of something to run: `TENSORMAP_TORTURE_<NAME>`, or the default."""
    return int(os.environ.get(f"{_PREFIX}{name.upper()}") or default)


def seconds(variable: str, default: float) -> float:
    """Return how long something lasts: the variable's value, or the default."""
    return float(os.environ.get(variable) or default)


def chance(*words: object) -> random.Random:
    """Return a source of chance of its own for each use, the same in every run of a seed.

    Examples:
        >>> chance("kills", 3).random() == chance("kills", 3).random()
        True
    """
    return random.Random(f"{SEED} {words}")
