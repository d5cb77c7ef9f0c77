"""Split rules of published protocols, on trajectories whose counts are done by hand."""

import numpy as np
import pytest

from core.errors import EmptyDrive, InvalidParameters
from core.evaluation.compare import ComparisonProtocol, compare
from core.evaluation.methods import Enrolled, Nearest
from core.evaluation.pairing import LoopClosing, SecondPass
from core.evaluation.protocol import (
    FIELD_PROTOCOLS,
    KITTI_SCANS,
    FieldProtocol,
    FirstScans,
    FirstSeconds,
    Thinned,
    field_protocol,
    findable,
)
from core.evaluation.retrieval import Counting
from core.evaluation.selected import SelectedScans
from core.scans.accumulation import AccumulatedDrive
from core.scans.drive import scan_index_of
from core.scans.pose import UNKNOWN_POSE, Pose
from core.scans.scan import Scan


class Path:
    """A drive of poses along x, ten a second, one scan each; heights and gaps if given."""

    def __init__(self, xs, name="path", *, zs=None, unknown=(), step_s=0.1):
        self.name = name
        self.poses = np.zeros((len(xs), 7))
        self.poses[:, 0], self.poses[:, 6] = xs, 1.0
        if zs is not None:
            self.poses[:, 2] = zs
        self.poses[list(unknown)] = UNKNOWN_POSE
        self.timestamp_s = step_s * np.arange(len(xs))

    def __len__(self):
        return len(self.poses)

    def scan(self, index):
        points = np.array([[5.0 + index, 0.0, 1.0]])
        return Scan(points, timestamp_s=index, pose=Pose.from_row(self.poses[index]))


def scans_of(view):
    return view.scans.tolist()


def halves(rule, *drives, **other):
    """Return what is mapped and what queries it, under a preset of that rule."""
    drive, query_drive = (*drives, None)[:2]
    prepared = preset(rule, **other).prepare(drive, query_drive)
    assert prepared.queried is not None
    return prepared.mapped, prepared.queried


def preset(rule, **other):
    return FieldProtocol("a preset", rule, (5.0,), "here", **other)


def test_first_scans_are_mapped_and_the_last_query_after_a_gap():
    mapped, queried = halves(FirstScans(4, 2), Path(range(10)))
    assert scans_of(mapped) == [0, 1, 2, 3]
    assert scans_of(queried) == [6, 7, 8, 9]


@pytest.mark.parametrize(
    ("sequence", "mapped", "queries"),
    [
        ("00", 3000, 1341),
        ("02", 3400, 1061),
        ("05", 1000, 1561),
        ("06", 600, 301),
        ("08", 1000, 2871),
    ],
)
def test_bevplace_splits_the_whole_of_kittis_sequences(sequence, mapped, queries):
    drive = Path(np.zeros(KITTI_SCANS[sequence]), sequence)
    places, queried = halves(field_protocol("bevplace", drive, "KITTI").rule, drive)
    assert (len(places), len(queried)) == (mapped, queries)
    assert queried.scans[0] == mapped + 200


def test_first_seconds_are_mapped_and_scans_while_standing_left_out():
    # Ten scans a second: 0.0 to 0.4 s mapped, from 0.4 s on queries; it stands at 0 m and at 4 m.
    drive = Path([0.0, 0.0, 0.05, 1.0, 2.0, 3.0, 4.0, 4.0, 4.09, 4.11])
    mapped, queried = halves(FirstSeconds(0.4, 0.1), drive)
    assert scans_of(mapped) == [0, 3, 4]
    assert scans_of(queried) == [4, 5, 6, 9]


def test_two_drives_are_thinned_each_from_its_own_first_scan():
    first, second = Path(np.arange(0.0, 100.0, 4.0)), Path(np.arange(1.0, 60.0, 2.0), "other")
    mapped, queried = halves(Thinned(20.0, 5.0), first, second)
    assert (4.0 * mapped.scans).tolist() == [0.0, 20.0, 40.0, 60.0, 80.0]
    assert (1.0 + 2.0 * queried.scans).tolist() == [
        1.0, 7.0, 13.0, 19.0, 25.0, 31.0, 37.0, 43.0, 49.0, 55.0,
    ]  # fmt: skip


def test_queries_without_a_place_may_be_left_out_at_all():
    first, second = Path([0.0, 20.0, 40.0]), Path([5.0, 5.1, 14.9, 15.0, 46.0], "other")
    rule = Thinned(1.0, 0.01)
    assert scans_of(halves(rule, first, second, only_findable=True)[1]) == [0, 3]
    mapped, queried = halves(rule, first, second)
    assert len(queried) == 5
    assert scans_of(findable(mapped, queried, 6.0)) == [0, 1, 2, 3, 4]


def test_a_planar_protocol_leaves_heights_out_of_every_distance():
    first, second = Path([0.0, 20.0], zs=[0.0, 0.0]), Path([1.0, 21.0], "other", zs=[30.0, 0.0])
    rule = Thinned(1.0, 1.0)
    _, flat = halves(rule, first, second, planar=True, only_findable=True)
    assert scans_of(flat) == [0, 1]
    assert flat.poses[:, 2].tolist() == [0.0, 0.0]
    pose = flat.scan(0).pose
    assert pose is not None
    assert pose.z_m == 0.0
    assert scans_of(halves(rule, first, second, only_findable=True)[1]) == [1]


def test_scans_without_a_pose_are_neither_mapped_nor_queried():
    prepared = preset(LoopClosing(2)).prepare(Path(range(6), unknown=[0, 4]), None)
    assert scans_of(prepared.mapped) == [1, 2, 3, 5]
    assert prepared.queried is None
    assert prepared.mapped.scan(3).points_m[0, 0] == 10.0  # of scan 5


def test_each_preset_has_the_tolerances_exclusions_and_counting_of_its_script():
    drive = Path(np.zeros(4541), "00")
    made = {name: field_protocol(name, drive, "KITTI") for name in FIELD_PROTOCOLS}
    assert {name: one.tolerances_m for name, one in made.items()} == {
        "bevplace": (5.0,), "logg3d": (3.0,), "solid": (10.0,), "scancontext": (5.0,),
        "egonn": (5.0, 20.0), "ring": (25.0, 10.0),
    }  # fmt: skip
    assert made["logg3d"].pairing == LoopClosing(None, 30.0)
    assert field_protocol("logg3d", drive, "MulRan").pairing == LoopClosing(None, 90.0)
    assert made["solid"].pairing == LoopClosing(100)
    assert made["scancontext"].pairing == LoopClosing(50)
    assert made["bevplace"].pairing == made["egonn"].pairing == made["ring"].pairing == SecondPass()
    assert made["logg3d"].counting == Counting(wrong_beyond_m=20.0, of_rejected=True)
    assert made["scancontext"].counting == Counting(of_rejected=True)
    assert [name for name, one in made.items() if one.planar] == ["egonn", "ring"]
    assert made["egonn"].rule == FirstSeconds(170.0, 0.1)
    assert field_protocol("egonn", Path(range(2761), "05"), "KITTI").rule == FirstSeconds(
        100.0, 0.1
    )
    assert field_protocol("egonn", Path(range(9), "DCC01"), "MulRan").rule == Thinned(10.0, 10.0)
    assert made["ring"].rule == Thinned(20.0, 5.0)
    assert str(made["logg3d"]) == (
        "logg3d: loop closing, with places at least 30 s before; right within 3 m"
    )


class Last:
    """Answers with the last place that may be searched, the sooner the surer."""

    name = "last"

    def configuration(self):
        return {}

    def enrol(self, drive, scans, progress=None):
        def describe(scan):
            return lambda before: Nearest(before - 1, float(scan.timestamp_s))

        return Enrolled(scans, None, None, describe)


def test_loops_are_compared_with_the_presets_exclusion_tolerance_and_counting():
    # Answers, three scans before each: 5 queries, at 2, 30, 9, 1 and 40 m from their answers.
    drive = Path([0.0, 100.0, 200.0, 2.0, 130.0, 209.0, 1.0, 170.0])
    one = FieldProtocol(
        "a preset", LoopClosing(3), (3.0,), "here", counting=Counting(20.0, of_rejected=True)
    )
    prepared = one.prepare(drive, None)
    protocol = ComparisonProtocol(one.pairing, tolerances_m=(3.0,), counting=one.counting)
    [method] = compare(prepared.mapped, [Last()], protocol).methods
    [row] = method.conditions
    assert (row.queries, row.findable, row.recall_at_1) == (5, {3.0: 2}, {3.0: 1.0})
    # By falling score: right; wrong (30 m); neither (9 m); right; wrong. At the fourth precision is
    # 2 of 3 and recall 2 of 2; at the first 1 and 1 of 2.
    assert row.max_f1[3.0] == pytest.approx(0.8)
    assert row.average_precision[3.0] == pytest.approx(0.5 + 0.5 * 2 / 3)
    usual = ComparisonProtocol(one.pairing, tolerances_m=(3.0,))
    [row] = compare(prepared.mapped, [Last()], usual).methods[0].conditions
    assert row.average_precision[3.0] == pytest.approx(0.5 + 0.5 * 2 / 4)


@pytest.mark.parametrize(
    ("name", "drive", "layout", "message"),
    [
        ("bevplace", Path(range(9), "00"), "", r"sequences 00, 02, 05, 06, 08.*is '00'$"),
        ("bevplace", Path(range(9), "07"), "KITTI", "the drive is '07' in the layout of KITTI"),
        ("bevplace", Path(range(9), "00"), "KITTI", "00 has 4541 scans, this drive 9"),
        ("egonn", Path(range(9), "02"), "KITTI", "egonn has rules for KITTI's sequences 00, 05"),
        ("pointnetvlad", Path(range(9)), "", "there is no protocol 'pointnetvlad'; known are bev"),
    ],
)
def test_a_drive_that_a_preset_has_no_rules_for_is_refused(name, drive, layout, message):
    with pytest.raises(InvalidParameters, match=message):
        field_protocol(name, drive, layout)


def test_one_drive_where_two_are_wanted_and_nothing_left_are_refused():
    drive, other = Path(range(9)), Path(range(500, 509), "other")
    with pytest.raises(InvalidParameters, match="queries a drive with another: give a query drive"):
        preset(Thinned(1.0, 1.0)).prepare(drive, None)
    with pytest.raises(InvalidParameters, match="is of one drive: leave the query drive out"):
        preset(FirstScans(1, 1)).prepare(drive, other)
    with pytest.raises(EmptyDrive, match="leaves no scan of drive path to query"):
        preset(FirstScans(5, 9)).prepare(drive, None)
    with pytest.raises(EmptyDrive, match="not one of 9 queries of other is within 5 m of a place"):
        preset(Thinned(1.0, 1.0), only_findable=True).prepare(drive, other)
    with pytest.raises(EmptyDrive, match="no scan with a pose"):
        preset(LoopClosing(2)).prepare(Path([0.0], unknown=[0]), None)
    untimed = Path(range(9))
    untimed.timestamp_s = np.full(9, np.nan)
    with pytest.raises(InvalidParameters, match="scans without a timestamp"):
        preset(FirstSeconds(1.0, 0.1)).prepare(untimed, None)


def test_a_selection_is_a_drive():
    view = SelectedScans(Path(range(10)), np.array([1, 4, 9]))
    assert (view.name, len(view)) == ("path", 3)
    assert view.timestamp_s.round(6).tolist() == [0.1, 0.4, 0.9]
    assert view.poses[:, 0].tolist() == [1.0, 4.0, 9.0]
    assert view.scan(2).points_m[0, 0] == 14.0


def test_scans_of_a_selection_keep_their_numbers():
    view = SelectedScans(Path(range(10)), np.array([1, 4, 9]))
    assert scan_index_of(view).tolist() == [1, 4, 9]
    assert scan_index_of(view.only(np.array([0, 2]))).tolist() == [1, 9]
    odd = AccumulatedDrive(Path(range(10)), 3)
    assert scan_index_of(SelectedScans(odd, np.array([1, 3]))).tolist() == [5, 9]
