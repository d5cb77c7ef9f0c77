"""Methods on the same scans: what is right, what may be compared, what counts."""

import json

import numpy as np
import pytest

from baselines.m2dp import M2dp
from baselines.scan_context import ScanContext
from baselines.solid import Solid
from core.errors import EmptyDrive, InvalidParameters, InvalidScan
from core.evaluation.compare import ComparisonProtocol, compare
from core.evaluation.condition import Condition, conditions
from core.evaluation.methods import Enrolled, MappedPlaces, Nearest
from core.evaluation.pairing import HeldOut, LoopClosing, SecondPass
from core.evaluation.split import Every
from core.odometry.posed_drive import PosedDrive
from core.parameters import MapParameters
from core.scans.accumulation import AccumulatedDrive
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from tests.support.samples import FaultyDrive, RecordedProgress, sample_drive

pytestmark = pytest.mark.slow


class Fake:
    """A method with given answers: query timestamp in tenths -> (place, distance, relative yaw)."""

    def __init__(self, answers, name="fake"):
        self.name, self.answers, self.queried = name, answers, []

    def configuration(self):
        return {"answers": len(self.answers)}

    def enrol(self, drive, scans, progress=None):
        return Enrolled(scans, 7.0, 9.0, self.describe)

    def describe(self, scan):
        key = round(10 * scan.timestamp_s)
        if key < 0:
            raise InvalidScan("nothing there")

        def match(before):
            self.queried.append((key, before))
            found = self.answers.get(key)
            return None if found is None else Nearest(*found)

        return match


def line(xs, name="line", step=1):
    """A drive along x, one scan a tenth of a second."""
    return MemoryDrive(
        name,
        [
            Scan(np.array([[5.0, 0.0, 1.0]]), timestamp_s=0.1 * step * i, pose=Pose(x, 0.0, 0.0))
            for i, x in enumerate(xs)
        ],
    )


def test_figures_by_hand():
    # Places 0 and 2 at 0 m and 20 m; queries 1 at 2 m, 3 at 24 m, 5 at 90 m: nothing is near that.
    drive = line([0.0, 2.0, 20.0, 24.0, 50.0, 90.0])
    fake = Fake({1: (0, 0.1), 3: (1, 0.3), 5: (2, 0.2)})
    protocol = ComparisonProtocol(HeldOut(Every(2)), tolerances_m=(3.0, 5.0))
    elsewhere = line([500.0, 501.0], step=4)
    fake.answers[0], fake.answers[4] = (0, 0.15), (1, 0.9)
    [method] = compare(drive, [fake], protocol, unknown_drive=elsewhere).methods
    [row] = method.conditions
    assert (method.places, method.sent_bytes, method.stored_bytes) == (3, 7.0, 9.0)
    assert (row.queries, row.refusals, row.unanswered) == (3, 0, 0)
    assert row.findable == {3.0: 1, 5.0: 2}
    assert row.recall_at_1 == {3.0: 1.0, 5.0: 1.0}
    assert row.max_f1 == {3.0: 1.0, 5.0: pytest.approx(4 / 5)}
    assert row.average_precision[5.0] == pytest.approx(0.5 + 0.5 * 2 / 3)
    # Findable: 0.1 and 0.3; elsewhere: 0.15 and 0.9. Three of four pairs are in order.
    assert row.novelty_auroc == 0.75
    assert row.heading_error_deg_median is None


def test_no_answer_and_no_description_are_wrong():
    drive = line([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    faulty = FaultyDrive(drive, {3})
    fake = Fake({1: (0, 0.1)})
    [method] = compare(faulty, [fake], ComparisonProtocol(HeldOut(Every(2)))).methods
    row = method.conditions[0]
    assert (row.queries, row.refusals, row.unanswered) == (3, 1, 1)
    assert row.recall_at_1[3.0] == pytest.approx(1 / 3)
    assert row.max_f1[3.0] == pytest.approx(0.5)


def test_scans_without_a_pose_are_neither_places_nor_queries():
    drive = line([0.0, 2.0, 20.0, 24.0, 50.0, 51.0])
    poses = drive.poses.copy()
    poses[[2, 5]] = np.nan
    fake = Fake({1: (0, 0.1), 3: (1, 0.3)})
    protocol = ComparisonProtocol(HeldOut(Every(2)), tolerances_m=(3.0,))
    [method] = compare(PosedDrive(drive, poses), [fake], protocol).methods
    assert (method.places, method.conditions[0].queries) == (2, 2)
    assert [query for query, _ in fake.queried] == [1, 3]
    assert method.conditions[0].findable == {3.0: 1}
    assert method.conditions[0].recall_at_1 == {3.0: 1.0}


def test_the_heading_includes_the_yaw_of_the_condition():
    drive = line([0.0, 1.0, 2.0, 3.0])
    fake = Fake({1: (0, 0.1, 88.0), 3: (1, 0.1, None)})
    protocol = ComparisonProtocol(HeldOut(Every(2)), conditions=(Condition(yaw_deg=90.0),))
    [method] = compare(drive, [fake], protocol).methods
    assert method.conditions[0].heading_error_deg_median == pytest.approx(2.0)


def test_a_loop_is_closed_with_places_that_are_not_recent():
    drive = line([0.0, 10.0, 20.0, 1.0, 10.5])
    fake = Fake({2: (0, 0.5), 3: (0, 0.1), 4: (1, 0.2)})
    protocol = ComparisonProtocol(LoopClosing(recent_scans=2))
    [method] = compare(drive, [fake], protocol).methods
    assert fake.queried == [(2, 1), (3, 2), (4, 3)]
    row = method.conditions[0]
    assert row.queries == 3
    assert row.findable[3.0] == 2
    assert (row.recall_at_1[3.0], row.max_f1[3.0]) == (1.0, 1.0)


def test_recent_may_be_given_in_seconds_too():
    drive = line([0.0] * 6)
    fake = Fake({})
    compare(drive, [fake], ComparisonProtocol(LoopClosing(recent_scans=None, recent_s=0.35)))
    assert fake.queried == [(4, 1), (5, 2)]


def test_a_second_pass_queries_the_whole_map_with_another_drive():
    fake = Fake({0: (1, 0.1), 2: (0, 0.1)})
    result = compare(
        line([0.0, 9.0]), [fake], ComparisonProtocol(SecondPass(every=2)), line([8, 7, 6], "b")
    )
    assert fake.queried == [(0, None), (2, None)]
    assert result.methods[0].conditions[0].recall_at_1 == {3.0: 0.5, 5.0: 0.5, 10.0: 1.0}
    assert (result.drive, result.query_drive) == ("line", "b")


@pytest.mark.parametrize(
    ("pairing", "query", "message"),
    [
        (HeldOut(), "b", "leave the split"),
        (SecondPass(), None, "wants a query drive"),
        (LoopClosing(), "b", "within one drive"),
        (LoopClosing(recent_scans=90), None, "exclude less"),
    ],
)
def test_a_protocol_that_does_not_fit_the_drives_is_rejected(pairing, query, message):
    drive = line([0.0, 1.0, 2.0])
    query_drive = None if query is None else line([0.0], query)
    with pytest.raises(InvalidParameters, match=message):
        compare(drive, [Fake({})], ComparisonProtocol(pairing), query_drive)


def test_a_split_of_a_drive_shorter_than_its_step_maps_the_first_scan_alone():
    fake = Fake({})
    compare(line([0.0, 1.0, 2.0]), [fake], ComparisonProtocol(HeldOut(Every(90))))
    assert [scan for scan, _ in fake.queried] == [1, 2]


def test_invalid_values_are_rejected():
    drive = line([0.0, 1.0, 2.0])
    with pytest.raises(InvalidParameters, match="each once"):
        compare(drive, [Fake({}), Fake({})], ComparisonProtocol(HeldOut(Every(2))))
    with pytest.raises(InvalidParameters, match="has no scan with a pose"):
        compare(sample_drive(4, poses=False), [Fake({})], ComparisonProtocol(HeldOut(Every(2))))
    with pytest.raises(EmptyDrive):
        compare(MemoryDrive("empty", []), [Fake({})], ComparisonProtocol(HeldOut(Every(2))))
    with pytest.raises(InvalidParameters, match="some must be queried"):
        compare(line([0.0]), [Fake({})], ComparisonProtocol(HeldOut(Every(2))))
    without_time = MemoryDrive("d", [Scan(s.points_m, pose=s.pose) for s in drive])
    with pytest.raises(InvalidParameters, match="exclude by scans"):
        compare(without_time, [Fake({})], ComparisonProtocol(LoopClosing(None, 30.0)))
    for wrong in (
        {"tolerances_m": ()},
        {"tolerances_m": (0.0,)},
        {"conditions": ()},
        {"unknown_every": 0},
        {"seed": -1},
    ):
        with pytest.raises(InvalidParameters):
            ComparisonProtocol(**wrong)
    for recent in ((None, None), (5, 3.0), (0, None), (None, -1.0), (None, np.inf)):
        with pytest.raises(InvalidParameters):
            LoopClosing(*recent)
    with pytest.raises(InvalidParameters):
        SecondPass(0)


def compared_methods():
    return [
        MappedPlaces(MapParameters(), 6),
        MappedPlaces(MapParameters.for_sensor(encoding="harmonic"), 6),
        ScanContext(),
        ScanContext(candidates=3),
        Solid(),
        M2dp(),
    ]


@pytest.mark.parametrize("method", compared_methods(), ids=lambda c: c.name)
class TestMethods:
    def test_a_scan_of_the_drive_is_found_again(self, method):
        drive = sample_drive(8)
        enrolled = method.enrol(drive, np.arange(8))
        for index in range(8):
            found = enrolled.describe(drive.scan(index))(None)
            assert found is not None
            assert found.row == index

    def test_rows_are_the_usable_scans_and_before_counts_them(self, method):
        progress = RecordedProgress()
        drive = FaultyDrive(sample_drive(9), {2, 4})
        enrolled = method.enrol(drive, np.arange(1, 9), progress)
        assert enrolled.scans.tolist() == [1, 3, 5, 6, 7, 8]
        assert progress.stages[0][1] == progress.done[0] == 8
        found = enrolled.describe(sample_drive(9).scan(7))(2)
        assert found is not None
        assert found.row < 2
        assert enrolled.describe(sample_drive(9).scan(7))(0) is None

    def test_bytes_are_reported(self, method):
        enrolled = method.enrol(sample_drive(8), np.arange(8))
        assert enrolled.sent_bytes is not None
        assert enrolled.stored_bytes is not None
        assert 0 < enrolled.sent_bytes <= 4800
        assert enrolled.stored_bytes > 0

    def test_a_drive_without_a_usable_scan_is_rejected(self, method):
        with pytest.raises(EmptyDrive, match="no usable scan"):
            method.enrol(FaultyDrive(sample_drive(2), {0, 1}), np.arange(2))


def test_the_whole_is_plain_values_and_reports_its_progress():
    progress = RecordedProgress()
    protocol = ComparisonProtocol(
        HeldOut(Every(2), 6), conditions=conditions((0, 90), (0,), (0.01,)), unknown_every=2
    )
    result = compare(
        sample_drive(12), compared_methods(), protocol, unknown_drive=sample_drive(5, seed=3),
        progress=progress,
    )  # fmt: skip
    written = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert [method["name"] for method in written["methods"]] == [
        "paper", "harmonic", "scan-context", "scan-context-ring-key", "solid", "m2dp"
    ]  # fmt: skip
    row = written["methods"][2]["conditions"][1]
    assert (row["yaw_deg"], row["noise_m"], row["queries"]) == (90.0, 0.01, 6)
    assert set(row["recall_at_1"]) == {"3", "5", "10"}
    assert ("querying", 6 * 2 * 6) in progress.stages
    assert ("querying unknown places", 3 * 2 * 6) in progress.stages
    assert progress.done == [total for _, total in progress.stages]


def test_our_encodings_have_the_recall_that_evaluate_reports():
    """The same held-out scans of the same map, the same recall."""
    from core.evaluation.evaluate import EvaluationProtocol, evaluate

    drive = sample_drive(16)
    disturbed = conditions((0,), (0, 1), (0,))
    evaluated = evaluate(
        drive, EvaluationProtocol(segment_length=4, split=Every(2), conditions=disturbed)
    )
    protocol = ComparisonProtocol(HeldOut(Every(2), 4), conditions=disturbed)
    [compared] = compare(drive, [MappedPlaces(MapParameters(), 4)], protocol).methods
    for one, other in zip(evaluated.conditions, compared.conditions, strict=True):
        assert one.recall_at_1 == other.recall_at_1


def test_a_signatures_heading_is_that_of_an_answer_not_of_the_best_rendering(elsewhere):
    """Headings are compared every few degrees."""
    protocol = ComparisonProtocol(HeldOut(Every(2), 4), conditions=conditions((37.3,), (0,), (0,)))
    methods = [MappedPlaces(MapParameters.for_sensor(), 4, by_scan=one) for one in (False, True)]
    for compared in compare(elsewhere, methods, protocol).methods:
        [found] = compared.conditions
        assert found.recall_at_1[3.0] == 1.0
        assert found.heading_error_deg_median == pytest.approx(0.25, abs=0.25)


def test_a_drive_with_numbers_of_its_own_finds_itself():
    """Places are positions in the drive, whatever its scans are numbered."""
    drive = AccumulatedDrive(sample_drive(24, returns=150), 2)
    method = MappedPlaces(MapParameters.for_sensor(), 24)
    enrolled = method.enrol(drive, np.arange(len(drive)))
    assert enrolled.scans.tolist() == list(range(12))
    found = enrolled.describe(drive.scan(7))(None)
    assert found is not None
    assert found.row == 7
