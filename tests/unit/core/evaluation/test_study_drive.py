"""Studies of drives with a stretch that cannot be used."""

from dataclasses import replace

import pytest

from core.errors import InvalidParameters, InvalidScan
from core.evaluation.study_drive import StudyProtocol, segment_lengths_for, study_drive
from core.parameters import MapParameters
from core.scans.drive import MemoryDrive
from tests.support.recording import recording
from tests.support.samples import RecordedProgress

SCANS = 48
QUICK = StudyProtocol(
    (MapParameters.for_sensor(encoding="paper"),),
    r1=(3,),
    r2=(3,),
    noise_m=(0.0,),
    lateral_m=(0.0,),
    yaw_deg=(0.0,),
)


class Interrupted(MemoryDrive):
    """A drive some of whose scans in a row are broken."""

    def __init__(self, broken):
        super().__init__("d", recording().scans)
        self._broken = broken

    def scan(self, index):
        if index in self._broken:
            raise InvalidScan(f"scan {index} is broken")
        return super().scan(index)


def studied(broken, **options):
    [found] = study_drive(Interrupted(broken), replace(QUICK, **options)).encodings
    return found


def lengths_of(found):
    return {point.segment_length for point in found.sweep.points}


def test_no_length_is_tried_that_leaves_a_segment_without_a_scan():
    assert segment_lengths_for(SCANS) == (10, 25)
    assert lengths_of(studied(range(0))) == {10, 25}
    found = studied(range(20, 30))
    assert lengths_of(found) == {25}
    assert found.segments == 2


def test_ranks_that_were_not_tried_are_named_with_the_reason():
    assert "not tried" not in " ".join(studied(range(0)).advice.reasons)
    most, columns = QUICK.parameters[0].grid.shape
    found = studied(range(0), r1=(3, most + 1, most + 2), r2=(3, columns + 1))
    assert found.advice.reasons[-2:] == (
        f"r1 = {most + 1}, {most + 2} were not tried: the images have at most {most}.",
        f"r2 = {columns + 1} was not tried: the images have at most {columns}.",
    )
    assert {point.ranks for point in found.sweep.points} == {(3, 3)}


def test_a_drive_of_which_half_is_broken_is_one_segment():
    found = studied(range(24, SCANS))
    assert lengths_of(found) == {SCANS}
    assert found.segments == 1


def test_a_given_length_that_leaves_a_segment_without_a_scan_is_refused():
    refused = "k = 10: segment 2 is left without a map scan"
    with pytest.raises(InvalidParameters, match=refused):
        studied(range(20, 30), segment_lengths=(10, 24))
    with pytest.raises(InvalidParameters, match=refused):
        studied(range(20, 30), segment_lengths=(24,), segment_length=10)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"ranks": (100, 5)}, "100"),
        ({"r1": (400,)}, r"r1 is \[400\], wanted one of at most 30"),
        ({"segment_length": 1}, "k = 1: segment 2 is left without a map scan"),
        ({"segment_lengths": (1, 20)}, "k = 1: segment 2 is left without a map scan"),
    ],
)
def test_what_no_drive_can_have_is_refused_before_a_scan_is_read(wrong, message):
    progress = RecordedProgress()
    drive = Interrupted(range(SCANS))  # each scan that is read is refused
    with pytest.raises(InvalidParameters, match=message):
        study_drive(drive, replace(QUICK, **wrong), progress)
    assert progress.stages == []
