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
