"""Protocols of published evaluations: what is mapped, what queries, which answers are right.

Each is one preset, so that whoever has the data reproduces a published table by one command. The
rules are those of the public scripts that `source` names; those of `solid`, whose repository has no
script of its evaluation, are the paper's as we know it. A query without a place within the first
tolerance is in no denominator of recall, as in all of these scripts.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from core.errors import EmptyDrive, InvalidParameters
from core.evaluation.nearest import nearest_place
from core.evaluation.pairing import LoopClosing, Pairing, SecondPass
from core.evaluation.retrieval import Counting
from core.evaluation.selected import SelectedScans
from core.scans.drive import Drive
from core.scans.pose import is_known

KITTI, MULRAN = "KITTI", "MulRan"
"""Layouts of drives for which a protocol has rules of its own."""
KITTI_SCANS: Mapping[str, int] = {
    "00": 4541, "02": 4661, "05": 2761, "06": 1101, "07": 1101, "08": 4071,
}  # fmt: skip
"""Scans of KITTI's sequences that close loops."""


@dataclass(frozen=True)
class FirstScans:
    """The first scans of a drive are mapped; the last ones query, after some that are left out.

    Attributes:
        mapped: How many are mapped.
        left_out: How many are neither.
    """

    mapped: int
    left_out: int

    def split(self, drive: SelectedScans) -> tuple[SelectedScans, SelectedScans]:
        """Return what is mapped, and what queries it."""
        first = drive.scans < self.mapped
        return drive.only(first), drive.only(drive.scans >= self.mapped + self.left_out)

    def __str__(self) -> str:
        return f"scans below {self.mapped} mapped, those from {self.mapped + self.left_out} query"


@dataclass(frozen=True)
class FirstSeconds:
    """The first seconds of a drive are mapped, the rest queries; scans while standing are left out.

    Attributes:
        mapped_s: How many seconds are mapped.
        moved_m: Least distance between two scans of the map, or two queries.
    """

    mapped_s: float
    moved_m: float

    def split(self, drive: SelectedScans) -> tuple[SelectedScans, SelectedScans]:
        """Return what is mapped, and what queries it."""
        time_s = drive.timestamp_s - drive.timestamp_s[0]
        if not np.isfinite(time_s).all():
            raise InvalidParameters(f"drive {drive.name} has scans without a timestamp")
        first, rest = drive.only(time_s <= self.mapped_s), drive.only(time_s >= self.mapped_s)
        return first.apart(self.moved_m), rest.apart(self.moved_m)

    def __str__(self) -> str:
        return f"the first {self.mapped_s:g} s mapped, the rest queries, {self.moved_m:g} m apart"


@dataclass(frozen=True)
class Thinned:
    """One drive is mapped, another in the same world frame queries it, both thinned by distance.

    Attributes:
        map_m: Least distance between two scans of the map.
        query_m: The distance between two queries.
    """

    map_m: float
    query_m: float

    def __str__(self) -> str:
        return (
            f"a scan each {self.map_m:g} m mapped, of another drive each {self.query_m:g} m query"
        )


Rule = FirstScans | FirstSeconds | Thinned | LoopClosing
"""What is mapped and what queries."""


@dataclass(frozen=True)
class Prepared:
    """Drives as a protocol has them.

    Attributes:
        mapped: The places are scans of it.
        queried: The queries; `None` if the places themselves are, one after the other.
    """

    mapped: SelectedScans
    queried: SelectedScans | None


@dataclass(frozen=True)
class FieldProtocol:
    """A protocol of the field.

    Attributes:
        name: The preset's name.
        rule: What is mapped and what queries.
        tolerances_m: Within which an answer is right; the first is the protocol's own.
        source: The script, or the paper, with the rules.
        planar: Whether distances leave heights out.
        only_findable: Whether queries without a place within the first tolerance are left out at
            all, not only of recall.
        counting: How precision and recall count.
    """

    name: str
    rule: Rule
    tolerances_m: tuple[float, ...]
    source: str
    planar: bool = False
    only_findable: bool = False
    counting: Counting = field(default_factory=Counting)

    def __str__(self) -> str:
        plane = " without heights" if self.planar else ""
        return f"{self.name}: {self.rule}; right within {self.tolerances_m[0]:g} m{plane}"

    @property
    def pairing(self) -> Pairing:
        """How prepared drives are compared."""
        return self.rule if isinstance(self.rule, LoopClosing) else SecondPass()

    def prepare(self, drive: Drive, query_drive: Drive | None) -> Prepared:
        """Choose what is mapped and what queries it; scans without a pose are left out.

        Raises:
            EmptyDrive: If nothing is left to map, or to query.
            InvalidParameters: If it is of one drive and two are given, or the other way round, or
                times that it needs are unknown.
        """
        of_two = isinstance(self.rule, Thinned)
        if of_two and query_drive is None:
            raise InvalidParameters(f"{self.name} queries a drive with another: give a query drive")
        if not of_two and query_drive is not None:
            raise InvalidParameters(f"{self.name} is of one drive: leave the query drive out")
        mapped = self._with_pose(drive)
        if isinstance(self.rule, LoopClosing):
            return Prepared(mapped, None)
        if isinstance(self.rule, Thinned):
            other = self._with_pose(query_drive or drive)
            mapped, queried = mapped.apart(self.rule.map_m), other.apart(self.rule.query_m)
        else:
            mapped, queried = self.rule.split(mapped)
        for left, what in ((mapped, "map"), (queried, "query")):
            if not len(left):
                raise EmptyDrive(f"{self} leaves no scan of drive {left.name} to {what}")
        if self.only_findable:
            queried = findable(mapped, queried, self.tolerances_m[0])
        return Prepared(mapped, queried)

    def _with_pose(self, drive: Drive) -> SelectedScans:
        known = np.flatnonzero(is_known(drive.poses))
        if not len(known):
            raise EmptyDrive(f"drive {drive.name} has no scan with a pose, {self.name} needs them")
        return SelectedScans(drive, known, self.planar)


def findable(mapped: Drive, queried: SelectedScans, within_m: float) -> SelectedScans:
    """Return the queries that have a place within so many metres.

    Raises:
        EmptyDrive: If none has.
    """
    _, nearest_m = nearest_place(mapped.poses, queried.poses)
    has_place = np.flatnonzero(nearest_m <= within_m)
    if not len(has_place):
        raise EmptyDrive(
            f"not one of {len(queried)} queries of {queried.name} is within {within_m:g} m of a"
            f" place of {mapped.name}: are both in one world frame?"
        )
    return queried.only(has_place)


_Rule = TypeVar("_Rule")
_BEVPLACE_MAPPED = {"00": 3000, "02": 3400, "05": 1000, "06": 600, "08": 1000}
_EGONN_MAPPED_S = {"00": 170.0, "05": 100.0}


def _bevplace(sequence: str, layout: str, scans: int) -> FieldProtocol:
    mapped = _of_kitti("bevplace", _BEVPLACE_MAPPED, sequence, layout, scans)
    return FieldProtocol(
        "bevplace", FirstScans(mapped, 200), (5.0,), "zjuluolun/BEVPlace2 kitti_dataset.py"
    )


def _logg3d(_sequence: str, layout: str, _scans: int) -> FieldProtocol:
    return FieldProtocol(
        "logg3d",
        LoopClosing(None, 90.0 if layout == MULRAN else 30.0),
        (3.0,),
        "csiro-robotics/LoGG3D-Net eval_sequence.py",
        counting=Counting(wrong_beyond_m=20.0, of_rejected=True),
    )


def _solid(_sequence: str, _layout: str, _scans: int) -> FieldProtocol:
    return FieldProtocol("solid", LoopClosing(100), (10.0,), "SOLiD, Kim et al., RA-L 2024")


def _scancontext(_sequence: str, _layout: str, _scans: int) -> FieldProtocol:
    return FieldProtocol(
        "scancontext",
        LoopClosing(50),
        (5.0,),
        "irapkaist/scancontext fast_evaluator",
        counting=Counting(of_rejected=True),
    )


def _egonn(sequence: str, layout: str, scans: int) -> FieldProtocol:
    rule: Rule = Thinned(10.0, 10.0)
    if layout == KITTI:
        rule = FirstSeconds(_of_kitti("egonn", _EGONN_MAPPED_S, sequence, layout, scans), 0.1)
    return FieldProtocol(
        "egonn",
        rule,
        (5.0, 20.0),
        "csiro-robotics/SpectralGV generate_evaluation_sets.py",
        planar=True,
        only_findable=True,
    )


def _ring(_sequence: str, _layout: str, _scans: int) -> FieldProtocol:
    return FieldProtocol(
        "ring",
        Thinned(20.0, 5.0),
        (25.0, 10.0),
        "lus6-Jenny/RINGSharp generate_evaluation_sets.py",
        planar=True,
        only_findable=True,
    )


FIELD_PROTOCOLS: Mapping[str, Callable[[str, str, int], FieldProtocol]] = {
    "bevplace": _bevplace,
    "logg3d": _logg3d,
    "solid": _solid,
    "scancontext": _scancontext,
    "egonn": _egonn,
    "ring": _ring,
}
"""The presets: of a drive's name, its layout and its number of scans."""


def field_protocol(name: str, drive: Drive, layout: str = "") -> FieldProtocol:
    """Return a preset for a drive.

    Args:
        name: The preset's name.
        drive: What is mapped; its name is the sequence's where the rules depend on it.
        layout: The layout of the drive's folder, such as `KITTI`.

    Raises:
        InvalidParameters: If there is no such preset, or its rules do not have this drive.
    """
    if name not in FIELD_PROTOCOLS:
        raise InvalidParameters(
            f"there is no protocol {name!r}; known are {', '.join(FIELD_PROTOCOLS)}"
        )
    return FIELD_PROTOCOLS[name](drive.name, layout, len(drive))


def _of_kitti(
    name: str, rules: Mapping[str, _Rule], sequence: str, layout: str, scans: int
) -> _Rule:
    if layout != KITTI or sequence not in rules:
        raise InvalidParameters(
            f"{name} has rules for KITTI's sequences {', '.join(rules)}, named so by their folder;"
            f" the drive is {sequence!r}" + (f" in the layout of {layout}" if layout else "")
        )
    if scans != KITTI_SCANS[sequence]:
        raise InvalidParameters(
            f"KITTI's sequence {sequence} has {KITTI_SCANS[sequence]} scans, this drive {scans}:"
            f" {name} counts scans of the whole sequence"
        )
    return rules[sequence]
