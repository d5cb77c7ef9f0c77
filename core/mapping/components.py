"""Components of a map: the drives in its frame, and those that lie beside them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from core.mapping.placement import Placement


def drives_aside(drives: Sequence[str], placements: Mapping[str, Placement]) -> frozenset[str]:
    """Return the drives that are not in the frame of their map: their place beside it is arbitrary.

    A drive without a placement is in the frame, and so is one that was fitted to a drive in it. One
    that was fitted only to drives aside lies aside with them. If no drive has the frame, as when
    those that had it were removed, it is that of the first drive and of all that were fitted to one
    another with it.

    Args:
        drives: The drives that have poses, in the map's order.
        placements: The placements of drives, by name. A drive of `others` that is not one of the
            map was in its frame, see `placements_without`.

    Examples:
        >>> lies = Placement((0.0, 0.0, 0.0, 1.0), (1000.0, 0.0, 0.0))
        >>> meets = replace(lies, others=("b",), matches=20)
        >>> sorted(drives_aside(["a", "b", "c"], {"b": lies, "c": meets}))
        ['b', 'c']
        >>> sorted(drives_aside(["b", "c"], {"b": lies, "c": meets}))
        []
    """
    fitted_to = {
        name: frozenset(placements[name].others) if name in placements else frozenset[str]()
        for name in drives
    }
    removed = frozenset[str]().union(*fitted_to.values()) - {*drives}
    in_frame = _reached({name for name in drives if name not in placements} | removed, fitted_to)
    if drives and not in_frame:
        in_frame = _component(drives[0], fitted_to)
    return frozenset(drives) - in_frame


def placements_without(
    drives: Sequence[str], placements: Mapping[str, Placement], removed: Collection[str]
) -> dict[str, Placement]:
    """Return the placements of the drives that are left in a map when others are removed.

    A drive stays in the frame of the map when those that it was fitted to are gone. One that lies
    aside with drives that are gone must stay aside: it names the first drive that is left of its
    component instead, with the figures of its fit, or none if it is that one, and no figures.

    Args:
        drives: The drives of the map that have poses, in its order.
        placements: The placements of its drives, by name.
        removed: The names of those that are removed.
    """
    left = {name: placement for name, placement in placements.items() if name not in removed}
    aside = drives_aside(drives, placements)
    fitted_to = {name: frozenset(placements[name].others) for name in drives if name in aside}
    for name in fitted_to:
        if name not in left or not fitted_to[name] & {*removed}:
            continue
        placement = left[name]
        others = tuple(other for other in placement.others if other not in removed)
        if not others:
            component = _component(name, fitted_to)
            first = next(other for other in fitted_to if other in component and other in left)
            others = (first,) if first != name else ()
        left[name] = (
            replace(placement, others=others)
            if others
            else Placement(placement.rotation, placement.translation_m)
        )
    return left


def _component(drive: str, fitted_to: Mapping[str, frozenset[str]]) -> set[str]:
    """Return a drive and all that were fitted to one another with it."""
    both_ways = {
        name: others | {other for other in fitted_to if name in fitted_to[other]}
        for name, others in fitted_to.items()
    }
    return _reached({drive}, both_ways)


def _reached(start: Collection[str], fitted_to: Mapping[str, Collection[str]]) -> set[str]:
    """Return drives, and those that were fitted to one of them, or to one of these."""
    reached = {*start}
    while found := {
        name for name, others in fitted_to.items() if name not in reached and reached & {*others}
    }:
        reached |= found
    return reached
