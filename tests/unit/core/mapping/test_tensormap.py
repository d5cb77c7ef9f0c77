"""What a map is made of."""

import pytest

from core.errors import InvalidMap
from core.mapping.tensormap import TensorMap
from tests.support.samples import sample_map


@pytest.mark.parametrize(
    ("name", "dtype"),
    [("signatures", "c16"), ("pose", "c16"), ("scan_index", "f8"), ("segment_start", "U8")],
)
def test_parts_of_another_kind_are_no_map(name: str, dtype: str) -> None:
    made = sample_map(count=6, segment_length=3)[0]
    arrays = made.arrays() | {name: made.arrays()[name].astype(dtype)}
    with pytest.raises(InvalidMap, match=f"{name} has dtype"):
        TensorMap.from_parts(arrays, made.attributes())
