"""Maps that take seconds to build, built by one worker of a run for all of them."""

from collections.abc import Callable
from pathlib import Path

from core.mapping.tensormap import TensorMap
from storage.files.map_file import read_map, write_map
from tests.support.locks import one_at_a_time


def map_once(shared: Path, name: str, build: Callable[[], TensorMap]) -> TensorMap:
    """Return a map as it is read from its file, which is made if it is not there."""
    path = shared / f"{name}.h5"
    with one_at_a_time(path.with_suffix(".lock")):
        if not path.exists():
            made = path.with_suffix(".part")
            write_map(made, build())
            made.rename(path)
    return read_map(path)
