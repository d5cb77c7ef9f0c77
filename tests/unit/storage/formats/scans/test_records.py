"""Records of NCLT and nuScenes."""

import numpy as np
import pytest

from storage.formats.errors import TruncatedScan, WrongDtype
from storage.formats.scans.records import NcltFormat, NuscenesFormat

POINTS = np.random.default_rng(0).normal(scale=20.0, size=(300, 3)).astype(np.float32)


class TestRecords:
    def test_nclt_points_are_rotated_to_z_up_and_moved_to_the_lidar(self) -> None:
        # The vehicle's origin, and a point 1 m ahead of it, to its right and below it.
        raw = np.array([[20000, 20000, 20000], [20200, 20200, 20200]], "<u2")
        body = b"".join(row.tobytes() + b"\x07\x05" for row in raw)
        np.testing.assert_allclose(
            NcltFormat().read(body), [[-0.002, -0.004, -0.957], [0.998, -1.004, -1.957]], atol=1e-6
        )

    @pytest.mark.parametrize("dtype", ["<f4", "<f8"])
    def test_floats_are_not_taken_for_nclt(self, dtype: str) -> None:
        body = np.pad(POINTS, ((0, 0), (0, 1))).astype(dtype).tobytes()
        with pytest.raises(WrongDtype, match="laser"):
            NcltFormat().read(body)

    def test_kitti_is_not_taken_for_nuscenes(self) -> None:
        body = np.pad(POINTS, ((0, 0), (0, 1)), constant_values=0.3).astype("<f4").tobytes()
        assert len(body) % 20 == 0
        with pytest.raises(WrongDtype, match="ring"):
            NuscenesFormat().read(body)

    @pytest.mark.parametrize("known", [NuscenesFormat(), NcltFormat()])
    def test_a_part_of_a_record_is_rejected(self, known: NuscenesFormat | NcltFormat) -> None:
        with pytest.raises(TruncatedScan):
            known.read(bytes(39))
