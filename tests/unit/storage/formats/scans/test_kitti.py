"""KITTI's `.bin`: raw floats, recognized by their values only."""

import io

import numpy as np
import pytest

from core.errors import TooFewReturns
from core.scans.scan import Scan
from storage.formats.errors import ScanTooLarge, TruncatedScan, WrongDtype
from storage.formats.scans.kitti import KittiFormat, require_plausible
from storage.formats.scans.registry import read_scan

KITTI = "application/vnd.tensormap.kitti"


def street(returns: int = 400) -> np.ndarray:
    """Return `(n, 4)` float32 returns like a street's."""
    random = np.random.default_rng(1)
    xyz = random.normal(0, 20, (returns, 3)) * [1, 1, 0.1]
    return np.column_stack([xyz, random.random(returns)]).astype("<f4")


def read(body: bytes) -> Scan:
    return read_scan(body, media_type=KITTI, min_returns=1)


def test_the_points_are_the_first_three_of_each_four_floats() -> None:
    written = street()
    scan = read(written.tobytes())
    np.testing.assert_array_equal(scan.points_m, written[:, :3])


def test_returns_that_are_not_finite_or_zero_are_dropped_and_counted() -> None:
    written = street()
    written[:150, :3] = np.nan
    written[150:300, :3] = 0.0
    written[300, 1] = np.inf
    scan = read(written.tobytes())
    assert (len(scan), scan.dropped_returns) == (99, 301)


def test_a_scan_of_nothing_but_no_returns_has_too_few_returns() -> None:
    with pytest.raises(TooFewReturns, match="0 of 400"):
        read(np.full((400, 4), np.nan, "<f4").tobytes())


def test_the_error_for_a_truncated_file_has_its_length_and_that_of_a_record() -> None:
    with pytest.raises(TruncatedScan, match=r"6393 bytes.* records of 16 and 9 left over"):
        read(street().tobytes()[:-7])


@pytest.mark.parametrize(
    "body",
    [
        pytest.param(street().astype("<f8").tobytes(), id="doubles"),
        pytest.param(street()[:, :3].astype("<f8").tobytes(), id="doubles of three columns"),
        pytest.param((street().astype("<f8") * np.pi).tobytes(), id="doubles never held by floats"),
        pytest.param((street() * 1000).astype("<i4").tobytes(), id="int32 millimetres"),
        pytest.param((street() * 100).astype("<i2").tobytes(), id="int16 centimetres"),
        pytest.param(street().astype(">f4").tobytes(), id="big-endian floats"),
        pytest.param(b"12.345 6.789 -1.234\n" * 400, id="text"),
    ],
)
def test_numbers_of_another_type_are_rejected_with_the_expected_type(body: bytes) -> None:
    with pytest.raises(WrongDtype, match="float32 little-endian x y z reflectance"):
        read(body)


def test_a_few_odd_values_do_not_make_a_scan_of_another_type() -> None:
    written = street()
    written[:30, 0] = 1e-9
    assert len(read(written.tobytes())) == 400


@pytest.mark.parametrize("seed", range(40))
def test_a_scan_with_more_than_a_quarter_of_implausible_coordinates_is_rejected(seed) -> None:
    """No-returns do not count, nor do single coordinates of zero."""
    random = np.random.default_rng(seed)
    kinds = np.array([0.0, 5.0, -30.0, 1e-9, 1e9, np.nan, np.inf], np.float32)
    share = random.dirichlet([2.0, 4.0, 4.0, 0.4, 0.4, 0.4, 0.4])
    returns_m = random.choice(kinds, size=(20, 3), p=share).astype(np.float32)
    found = implausible = 0
    for row in returns_m.tolist():
        for one in row if np.isfinite(row).any() else ():
            found += one != 0.0
            implausible += one != 0.0 and not 1e-6 <= abs(one) <= 1e5
    if implausible > 0.25 * found:
        with pytest.raises(WrongDtype, match=f"^{implausible / found:.0%} of the coordinates"):
            require_plausible(returns_m, "metres")
    else:
        require_plausible(returns_m, "metres")


def test_records_of_another_length_are_rejected_and_both_are_named() -> None:
    xyzi = street()
    ring = np.arange(len(xyzi), dtype="<f4") % 32
    for other in (
        np.column_stack([xyzi, ring]),  # nuScenes
        xyzi[:, :3],
        np.column_stack([xyzi, ring, np.linspace(0.0, 0.1, len(xyzi))]),
    ):
        with pytest.raises(WrongDtype, match=r"nuScenes' 20 bytes .* or 12 .* 16 bytes a return"):
            read(np.ascontiguousarray(other, "<f4").tobytes())
    unknown = xyzi.copy()
    unknown[:, 3] = -1.0  # not measured
    assert len(read(unknown.tobytes())) == len(xyzi)


@pytest.mark.parametrize("measured", [1.0, 0.02])
def test_points_of_pcl_in_memory_are_rejected(measured: float) -> None:
    """Of `pcl::PointXYZI`; intensities of 0 make the second half of a record a no-return."""
    xyzi = street()
    xyzi[round(measured * len(xyzi)) :, 3] = 0.0
    padded = np.zeros((len(xyzi), 8), "<f4")
    padded[:, :3], padded[:, 3], padded[:, 4] = xyzi[:, :3], 1.0, xyzi[:, 3]
    message = r"^every other record is a number and three zeros: .* 32 bytes, .* 16 bytes a return"
    with pytest.raises(WrongDtype, match=message):
        read(padded.tobytes())


def test_returns_on_an_axis_make_no_other_records() -> None:
    written = street(2000)
    written[1000:] = 0.0
    written[500:1000, 1:] = 0.0  # as of a simulated wall straight ahead
    assert len(read(written.tobytes())) == 1000
    on_axis = np.array([[10, 0, 0, 0]] * 6, "<f4")
    assert len(read(on_axis.tobytes())) == 6


def test_millimetres_and_coordinates_of_a_map_are_rejected_in_any_format() -> None:
    points = street()[:, :3]
    file = io.BytesIO()
    np.save(file, points * 1000)
    with pytest.raises(WrongDtype, match="millimetres, or a map's coordinates"):
        read_scan(file.getvalue(), suffix=".npy", min_returns=1)
    records = street()
    records[:, :2] += [455_000, 5_428_000]  # UTM
    with pytest.raises(WrongDtype):
        read(records.tobytes())
    far = street()
    far[::3, :3] *= 1000  # what a third of the returns are is no unit
    assert len(read(far.tobytes())) == len(far)


def test_the_number_of_returns_is_bounded_by_the_budget() -> None:
    with pytest.raises(ScanTooLarge, match=r"4194305 returns, at most 4194304"):
        KittiFormat().read(bytes(16 * (2**22 + 1)))
