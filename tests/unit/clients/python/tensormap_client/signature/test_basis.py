"""A signature with all numbers is that of the core, to the byte."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from tensormap_client import Basis, TooFewCells, UnsupportedMap

from core.encodings.signature import pack_signatures
from core.parameters import MapParameters
from core.projection.imager import Views
from core.projection.rings import RingGrid
from core.scans.scan import Scan
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.client_bases import PARAMETERS, all_numbers, as_downloaded, basis_of

ANY_VIEWS = {
    **{name: one for name, one in PARAMETERS.items() if one.views == Views.ANY},
    "any, 12 x 14": MapParameters.for_sensor(ranks=(12, 14), views=Views.ANY),
    "any, 20 columns": replace(PARAMETERS["default"], grid=RingGrid(azimuth_step_deg=18.0)),
}
EQUAL_TO_THE_DEFAULT = [name for name in PARAMETERS if name not in ANY_VIEWS]


@functools.cache
def full_view():
    drive = SimulatedDrive(seed=3, scans=4, stops=False, sensor=SimulatedSensor(firings=360))
    return drive.scan(2).points_m


def seen(share, reach_m=np.inf):
    """Return the returns in a share of the azimuths, up to a distance."""
    points = full_view()
    ahead = np.abs(np.arctan2(points[:, 1], points[:, 0])) <= np.pi * share
    return points[ahead & (np.hypot(points[:, 0], points[:, 1]) < reach_m)]


VIEWS = {
    "full": (1.0, np.inf),
    "partial": (0.8, np.inf),
    "narrow": (0.3, np.inf),
    "of short reach": (1.0, 20.0),
    "narrow, of short reach": (0.3, 20.0),
}


@pytest.mark.parametrize("name", VIEWS)
def test_the_views_are_what_their_names_say(name):
    view = basis_of(PARAMETERS["default"]).image(Scan.from_returns(seen(*VIEWS[name]))).view
    assert view.is_full == (name == "full")
    assert view.is_narrow == (name not in {"full", "partial"})
    assert (view.rings is not None) == name.endswith("of short reach")


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ANY_VIEWS)
def test_all_numbers_are_those_that_maps_of_any_views_keep(name, view):
    points, basis = seen(*VIEWS[view]), basis_of(ANY_VIEWS[name])
    packed = as_downloaded(basis).encode(points, all_numbers=True)
    assert packed == all_numbers(basis, basis.image(Scan.from_returns(points)))


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", PARAMETERS)
def test_a_scan_of_too_few_cells_has_no_signature(name, view):
    points, basis = seen(*VIEWS[view]), basis_of(PARAMETERS[name])
    occupied = basis.image(Scan.from_returns(points)).occupied_cells
    enough, more = (as_downloaded(basis, occupied + by) for by in (0, 1))
    assert enough.encode(points) == as_downloaded(basis).encode(points)
    with pytest.raises(TooFewCells, match=f"{occupied} cells .* at least {occupied + 1}"):
        more.encode(points)


@pytest.mark.parametrize(("view", "size_bytes"), [("full", 245), ("partial", 251), ("narrow", 251)])
def test_they_are_10_by_12_by_default_in_any_view(view, size_bytes):
    basis = as_downloaded(basis_of(PARAMETERS["default"]))
    packed = basis.encode(seen(*VIEWS[view]), all_numbers=True)
    assert (len(packed), *packed[9:11]) == (size_bytes, 10, 12)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", EQUAL_TO_THE_DEFAULT)
def test_maps_that_keep_what_is_sent_have_no_more_of_them(name, view):
    points, basis = seen(*VIEWS[view]), basis_of(PARAMETERS[name])
    packed = as_downloaded(basis).encode(points, all_numbers=True)
    assert packed == as_downloaded(basis).encode(points)
    assert packed == pack_signatures(basis.encode(basis.image(Scan.from_returns(points))))


@pytest.mark.parametrize("body", [b"", b'{"status": "ok"}', b"\x93NUMPY\x01\x00"])
def test_a_body_that_is_no_basis_is_named_without_a_word_of_pickles(body) -> None:
    with pytest.raises(UnsupportedMap, match=f"no map's basis: {len(body)} bytes .* wanted an"):
        Basis.from_npz(body)
