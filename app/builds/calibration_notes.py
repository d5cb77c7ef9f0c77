"""Notes of a build on answers without a probability, or without standard deviations."""

from collections.abc import Iterator, Sequence

from core.mapping.tensormap import TensorMap
from core.text import verb_of


def calibration_notes(tensor_map: TensorMap) -> Iterator[str]:
    """Yield a note if a map, or one kind of its queries, has no calibration, or no deviations.

    Deviations need probes that have a pose, as the scan has that they are found at.
    """
    # Which of the two a small map lacks depends on how many of their nearest matches are right.
    found = {
        "signature": tensor_map.calibration,
        "scan or image": tensor_map.calibration_of_scans,
    }
    without = [kind for kind, one in found.items() if one is None]
    if without:
        yield not_calibrated(_queries(without))
    known = tensor_map.trajectory.known
    with_pose = int(known.sum())
    without = [kind for kind, one in found.items() if one is not None and one.spread is None]
    if without and 0 < with_pose < len(known):
        yield (
            f"{with_pose} of {len(known)} scans {verb_of(with_pose, 'has', 'have')} a pose, and too"
            f" few of these are found at another one that has: no answer to a {_queries(without)}"
            " has standard deviations; put the poses of the other scans too"
        )


def _queries(kinds: Sequence[str]) -> str:
    return f"query by {kinds[0]}" if len(kinds) == 1 else "query"


def not_calibrated(queries: str) -> str:
    """Return the note on queries without a probability.

    Args:
        queries: Which ones, as in "every query".
    """
    return (
        "too few scans for a calibration, or all close together, or most of them 10 m or more"
        f" apart, or their returns are gone: every {queries} is localized, without a probability; a"
        " longer drive with scans a few metres apart gives one"
    )
