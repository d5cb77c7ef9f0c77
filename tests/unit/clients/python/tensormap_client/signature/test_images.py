"""The returns of a scan as the client takes them."""

import numpy as np
import pytest
from tensormap_client import UnusableScan
from tensormap_client.signature.images import returns

POINTS = np.random.default_rng(1).normal(scale=9.0, size=(500, 3)).astype(np.float32)


@pytest.mark.parametrize("unit", [np.float32, np.int32])
def test_millimetres_are_refused_as_the_service_refuses_them(unit):
    with pytest.raises(UnusableScan, match=r"^half of the returns are .*: are these millimetres"):
        returns((POINTS * 1000).astype(unit))
    few_far = np.concatenate([POINTS, POINTS[:100] * 1000])
    assert returns(few_far).shape == (3, 600)


@pytest.mark.parametrize("shape", [(500,), (20, 25)])
def test_records_with_the_fields_x_y_and_z_are_points(shape):
    fields = [("intensity", "u1"), ("z", "<f4"), ("x", "<f8"), ("y", "<f4")]
    records = np.zeros(500, fields)
    for axis, column in zip("xyz", POINTS.T, strict=True):
        records[axis] = column
    assert np.array_equal(returns(records.reshape(shape)), POINTS.T)


@pytest.mark.parametrize(
    "fields", [[("x", "f4"), ("y", "f4")], [("x", "U1"), ("y", "U1"), ("z", "U1")]]
)
def test_other_records_are_refused(fields):
    with pytest.raises(UnusableScan, match=r"wanted \(n, 3\) numbers, or records with x, y and z"):
        returns(np.zeros(500, fields))


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
def test_masked_points_are_left_out(dtype):
    points = (POINTS * 10).astype(dtype)
    mask = np.zeros(points.shape, bool)
    mask[::2] = True
    mask[1, 2] = True  # a point without z is none
    masked = np.ma.masked_array(points, mask)
    expected = returns(points[1::2][1:])
    assert np.array_equal(returns(masked), expected)
    records = np.zeros(len(points), [(axis, dtype) for axis in "xyz"])
    for axis, column in zip("xyz", points.T, strict=True):
        records[axis] = column
    of_records = np.ma.masked_array(records, [tuple(row) for row in mask])
    assert np.array_equal(returns(of_records), expected)
    assert returns(np.ma.masked_all((500, 3))).shape == (3, 0)


@pytest.mark.parametrize("points", [[[1, 2, 3], [1, 2]], ([1.0, 2.0, [3.0]],)])
def test_rows_of_several_lengths_are_no_scan(points):
    wanted = rf"^points are a {type(points).__name__} whose rows differ in length, wanted \(n, 3\)"
    with pytest.raises(UnusableScan, match=wanted):
        returns(points)
