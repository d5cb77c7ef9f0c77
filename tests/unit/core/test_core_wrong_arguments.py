"""Arguments of a wrong kind are errors of ours, which say what was wanted and what came."""

# mypy: disable-error-code="arg-type, list-item"
# Those who pass them have no type checker.

from itertools import repeat

import numpy as np
import pytest

from core.encodings.signature import Signature, pack_signatures, unpack_signatures
from core.errors import InvalidParameters, InvalidScan, InvalidSignature
from core.evaluation.split import Interleaved, parse_split
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.projection.reducer import Reducer
from core.scans.drive import MemoryDrive
from core.scans.pose import Pose
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor


@pytest.fixture(scope="module")
def drive():
    return SimulatedDrive(seed=1, scans=8, stops=False, sensor=SimulatedSensor(firings=180))


@pytest.fixture(scope="module")
def localizer(drive):
    return Localizer(build_map(drive, MapParameters(), segments=2))


@pytest.mark.parametrize("make", [Scan, Scan.from_returns])
def test_returns_of_which_numpy_would_drop_a_part_are_refused(make):
    points = np.ones((4, 3))
    with pytest.raises(InvalidScan, match="complex128, wanted real numbers"):
        make(points + 1j)
    masked = np.ma.masked_array(points)
    assert len(make(masked)) == 4
    masked[1, 2] = np.ma.masked
    with pytest.raises(InvalidScan, match=r"masked array, wanted a plain one: .*\.filled"):
        make(masked)
    assert len(Scan.from_returns(masked.filled(np.nan))) == 3


def test_scans_of_a_drive_come_from_any_iterable_and_are_scans():
    pose = Pose(1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
    scan = Scan(np.ones((4, 3)), timestamp_s=5.0, pose=pose)
    drive = MemoryDrive("monday", repeat(scan, 2))
    assert len(drive) == 2
    assert drive.poses[:, 0].tolist() == [1.0, 1.0]
    assert drive.timestamp_s.tolist() == [5.0, 5.0]
    with pytest.raises(InvalidParameters, match=r"scan 1 of drive monday is of type ndarray"):
        MemoryDrive("monday", [scan, scan.points_m])


@pytest.mark.parametrize("name", ["segments", "segment_length"])
def test_segments_are_whole_numbers(drive, name):
    for wrong in (2.5, "2"):
        with pytest.raises(InvalidParameters, match=f"{name} is {wrong!r}, wanted a whole number"):
            build_map(drive, MapParameters(), **{name: wrong})
    assert build_map(drive, MapParameters(), **{name: np.int64(2)}).model.segments >= 2


def test_the_segment_of_a_signature_is_a_whole_number():
    values = np.eye(5, dtype=np.float32)
    with pytest.raises(InvalidSignature, match=r"segment is 0\.5, wanted a whole number, 0\.\."):
        Signature(values, segment=0.5, revision="0f" * 32)
    assert Signature(values, segment=np.int64(1), revision="0f" * 32).segment == 1


def test_a_query_is_a_scan_or_a_sequence_of_signatures(drive, localizer):
    scan = drive.scan(3)
    with pytest.raises(InvalidScan, match="wanted a Scan, got ndarray"):
        localizer.localize_scan(scan.points_m)
    signatures = localizer.basis.encode(localizer.basis.image(scan))
    for wrong in (signatures[0], pack_signatures(signatures)):
        named = type(wrong).__name__
        with pytest.raises(InvalidSignature, match=f"a sequence of signatures, got {named}"):
            localizer.localize_signatures(wrong)
    for wrong in (2.5, "2"):
        with pytest.raises(InvalidParameters, match=f"k is {wrong!r}, wanted a whole number"):
            localizer.localize_scan(scan, k=wrong)
    assert len(localizer.localize_scan(scan, k=np.int64(2)).matches) == 2


@pytest.mark.parametrize("name", ["reducer", "segmentation", "views", "distance"])
def test_a_parameter_of_several_words_is_one_of_them(name):
    with pytest.raises(InvalidParameters, match=f"{name} is 'x', wanted one of [a-z]+, [a-z]+"):
        MapParameters(**{name: "x"})
    assert MapParameters(reducer="mean").reducer is Reducer.MEAN


def test_ranks_are_whole_numbers():
    with pytest.raises(InvalidParameters, match=r"ranks is \(2\.5, 3\), wanted \(r1, r2\), whole"):
        MapParameters(ranks=(2.5, 3))


def test_packed_signatures_are_any_bytes():
    one = Signature(np.eye(5, dtype=np.float32), segment=3, revision="0f" * 32)
    packed = pack_signatures([one])
    for body in (packed, bytearray(packed), memoryview(packed)):
        assert [found.segment for found in unpack_signatures(body)] == [3]
    for wrong in ("0f" * 32, 63):
        with pytest.raises(InvalidSignature, match=f"wanted bytes, got {type(wrong).__name__}"):
            unpack_signatures(wrong)


def test_a_split_has_as_many_phases_as_its_fraction_has_scans():
    assert parse_split("interleaved:0.2:4") == Interleaved(0.2, 4)
    with pytest.raises(InvalidParameters, match=r"phase is 9, wanted 0 to 4: 0\.2 has 5 phases"):
        parse_split("interleaved:0.2:9")
    assert Interleaved(0.3, 9).phase == 9
    starts = np.array([0, 40])
    held_out = {tuple(Interleaved(0.3, phase).held_out(starts)) for phase in range(10)}
    assert len(held_out) == 10


def test_the_largest_return_is_not_said_to_be_allowed():
    far = Scan(np.array([[1e30, 0.0, 0.0]], np.float32))  # of float32 slightly more
    with pytest.raises(InvalidScan, match=r"1e\+30 m away, wanted less than 1e\+30"):
        MapParameters().imager.image(far)
