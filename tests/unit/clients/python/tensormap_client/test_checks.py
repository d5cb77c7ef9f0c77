"""Arguments that cannot be right are named where they are given, with an error of the client."""

import math

import numpy as np
import pytest
from tensormap_client import Admin, InvalidArgument, Mounting, Tilt, Vehicle
from tensormap_client.signature.basis import Basis

URL = "http://maps.example"
NAN = float("nan")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Mounting(1.0, 2.0, 300.0), "z_m is 300.0, wanted above 0 and below 100"),
        (lambda: Mounting(51.0, 0.0, 2.0), "x_m is 51.0, wanted a number from -50 to 50"),
        (lambda: Mounting(1.0, 0.0, 2.0, yaw_deg=float("nan")), "yaw_deg is nan"),
        (lambda: Tilt(90.0, 0.0), "roll_deg is 90.0, wanted a number from -45 to 45"),
        (lambda: Tilt("1", 0.0), "roll_deg is '1'"),  # type: ignore[arg-type]
        (lambda: Vehicle(URL, None, "campus", sensor_height_m="a"), "sensor_height_m is 'a'"),  # type: ignore[arg-type]
        (lambda: Vehicle(URL, None, "campus", mounting=(1, 2, 3)), "wanted a Mounting"),  # type: ignore[arg-type]
        (lambda: Admin(URL).make_key("van", "localize"), r"scopes is 'localize', wanted several"),
        (
            lambda: Admin(URL).make_key("van", ["localize"], maps="yard"),
            r"maps is 'yard', wanted several, as \['yard'\]",
        ),
        (
            lambda: Admin(URL).fit_anchor("yard", "monday", [{"time_s": 1.0}, {"altitude_m": NAN}]),
            r"fixes\[1\]\['altitude_m'\] is nan, wanted a number that is finite",
        ),
        (lambda: Vehicle(URL, None, "a b/c"), "the map 'a b/c' is no slug"),
        (lambda: Vehicle(URL, "campus", None), "the map None is no slug"),  # type: ignore[arg-type]
        (lambda: Vehicle(URL, b"key", "campus"), "the key is a bytes, wanted a str or None"),  # type: ignore[arg-type]
        (lambda: Vehicle(5, None, "campus"), "'5' is no URL of a service"),  # type: ignore[arg-type]
        (lambda: Vehicle(URL, None, "campus", timeout_s=None), "timeout_s is None, wanted"),  # type: ignore[arg-type]
        (
            lambda: Admin(URL, patience_s=10**400),
            r"patience_s is 10+\.\.\., wanted a float of 0 or more",
        ),
        (lambda: Admin(URL, patience_s=10**5000), "patience_s is an integer of too many digits"),
        (lambda: Admin(URL, timeout_s=10**400), r"timeout_s is 10+\.\.\., wanted above 0"),
        (lambda: Mounting(1.0, 2.0, 10**400), r"z_m is 10+\.\.\., wanted above 0"),
        (lambda: Mounting(-(10**400), 2.0, 3.0), r"x_m is -10+\.\.\., wanted a number"),
    ],
)
def test_an_argument_that_cannot_be_right_is_named(make, message) -> None:
    with pytest.raises(InvalidArgument, match=message):
        make()


def test_patience_has_no_end_where_it_is_infinite() -> None:
    Admin(URL, patience_s=math.inf).close()


def test_numbers_of_numpy_are_numbers() -> None:
    Mounting(np.float32(1.0), np.int64(0), np.float64(2.0))  # type: ignore[arg-type]


def test_another_object_in_place_of_a_tilt_is_named() -> None:
    basis = Basis.__new__(Basis)
    object.__setattr__(basis, "parameters", {"sensor_height_m": 1.73})
    with pytest.raises(InvalidArgument, match=r"tilt is \(1, 2\), wanted a Tilt"):
        basis.encode([], tilt=(1, 2))  # type: ignore[arg-type]
