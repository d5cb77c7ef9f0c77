"""What a map is made of."""

from dataclasses import replace

import pytest

from core.confidence.calibration import Calibration
from core.errors import InvalidMap
from core.mapping.tensormap import TensorMap
from tests.support.samples import sample_map


def test_a_map_wants_as_many_cells_as_its_calibration_and_none_without() -> None:
    made = sample_map(count=6, segment_length=3)[0]
    calibration = Calibration(0.1, (0.0, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0), least_cells=9)
    wanted = [replace(made, calibration=one).least_cells for one in (None, calibration)]
    assert wanted == [0, 9]


@pytest.mark.parametrize(
    ("name", "dtype"),
    [("signatures", "c16"), ("pose", "c16"), ("scan_index", "f8"), ("segment_start", "U8")],
)
def test_parts_of_another_kind_are_no_map(name: str, dtype: str) -> None:
    made = sample_map(count=6, segment_length=3)[0]
    arrays = made.arrays() | {name: made.arrays()[name].astype(dtype)}
    with pytest.raises(InvalidMap, match=f"{name} has dtype"):
        TensorMap.from_parts(arrays, made.attributes())


def test_which_drives_have_computed_poses_is_part_of_a_map() -> None:
    tensor_map, _ = sample_map(drives=3)
    assert "computed_poses" not in tensor_map.attributes()
    odometry = replace(tensor_map, computed_poses=("drive-2", "drive-0", "drive-2"))
    assert odometry.computed_poses == ("drive-0", "drive-2")
    assert odometry.revision != tensor_map.revision
    again = TensorMap.from_parts(odometry.arrays(), odometry.attributes())
    assert again.computed_poses == odometry.computed_poses
    assert again.revision == odometry.revision


@pytest.mark.parametrize("odd", [[], ["drive-9"], "drive-0", [0], ["drive-1", "drive-0"], None])
def test_computed_poses_of_other_drives_are_no_map(odd: object) -> None:
    tensor_map, _ = sample_map(drives=2)
    with pytest.raises(InvalidMap):
        TensorMap.from_parts(
            tensor_map.arrays(), {**tensor_map.attributes(), "computed_poses": odd}
        )


def test_a_map_is_shown_in_a_line_with_its_size_and_revision_and_no_arrays() -> None:
    made = sample_map(count=6, segment_length=3)[0]
    shown = repr(made)
    assert shown.startswith("TensorMap(scans=6, drives=1, segments=2, encoding='paper', ranks=(")
    assert shown.endswith(f"revision='{made.revision}')")
    assert "\n" not in shown
    assert "array" not in shown
