"""A map's basis, and the signatures of scans that are made with it."""

import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tensormap_client.checks import require_height, require_number
from tensormap_client.errors import InvalidArgument, TooFewCells, UnsupportedMap, UnusableScan
from tensormap_client.signature.images import Grid, View, returns, rings_in_reach, without_others
from tensormap_client.signature.levelling import level, rotated
from tensormap_client.signature.packing import pack_harmonic, pack_paper

MEDIA_TYPE = "application/vnd.tensormap.basis+npz"
_ZIP = b"PK\x03\x04"
_MOST_RANKS, _MOST_SEGMENTS = 255, 0xFFFF  # that can be packed
_FARTHEST_M, _STEEPEST_DEG = 50.0, 45.0  # as the service takes them
_KEPT_HARMONICS = 12  # of maps of any views (signature.md, "Ranks")


@dataclass(frozen=True)
class Mounting:
    """A sensor's place in the vehicle's frame: x ahead, y to the left, z above the ground.

    R = Rz(yaw) Ry(pitch) Rx(roll); with a positive pitch the sensor looks down, with a positive yaw
    to the left.

    Raises:
        InvalidArgument: If x or y is not within 50 m, z not above 0 and below 100 m, or an angle
            not within 360 degrees.
    """

    x_m: float
    y_m: float
    z_m: float
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m"):
            require_number(name, getattr(self, name), _FARTHEST_M)
        require_height("z_m", self.z_m)
        for name in ("roll_deg", "pitch_deg", "yaw_deg"):
            require_number(name, getattr(self, name), 360.0)


@dataclass(frozen=True)
class Tilt:
    """A vehicle's roll (right side down) and pitch (front down) against gravity.

    Raises:
        InvalidArgument: If one is not within 45 degrees.
    """

    roll_deg: float
    pitch_deg: float

    def __post_init__(self) -> None:
        for name in ("roll_deg", "pitch_deg"):
            require_number(name, getattr(self, name), _STEEPEST_DEG)


def is_npz(body: bytes) -> bool:
    """Return whether a body may be an `.npz`: NumPy reads any other as a pickle, and says so."""
    return body.startswith(_ZIP)


def require_sensor(sensor_height_m: float | None, mounting: Mounting | None) -> None:
    """Check where a sensor is.

    Raises:
        InvalidArgument: If the height is given twice or is not above 0, or there is another object
            in place of a mounting.
    """
    if mounting is not None and sensor_height_m is not None:
        raise InvalidArgument("a mounting has a height: leave sensor_height_m out")
    if not isinstance(mounting, Mounting | None):
        raise InvalidArgument(f"mounting is {mounting!r}, wanted a Mounting")
    if sensor_height_m is not None:
        require_height("sensor_height_m", sensor_height_m)


@dataclass(frozen=True, eq=False)
class Basis:
    """What a vehicle needs to make a map's signatures; it contains no places.

    Attributes:
        digest: The basis's digest, which signatures contain.
        parameters: The map's parameters.
        arrays: `radial_basis (I, r1)` of a harmonic map; of one in the paper's encoding
            `segments (S,)`, `elevation_basis (S, I, r1)` and `azimuth_basis (S, J, r2)`.
        least_cells: A scan whose image has fewer occupied cells has no signature; 0 of a shared
            basis, of a map without calibration and of an older service.
    """

    digest: str
    parameters: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]
    least_cells: int = 0

    def __post_init__(self) -> None:
        encoding, views = self.parameters.get("encoding"), self.parameters.get("views", "full")
        if encoding not in {"harmonic", "paper"} or views not in {"full", "any"}:
            raise UnsupportedMap(
                f"the map has the encoding {encoding!r} and the views {views!r}, known are harmonic"
                " and paper, full and any"
            )
        r1, r2 = self.parameters["ranks"]
        many = len(self.arrays.get("segments", ()))
        if max(r1, r2) > _MOST_RANKS or many > _MOST_SEGMENTS:
            raise UnsupportedMap(
                f"the map has ranks {r1} x {r2} and {many} segments, ranks up to {_MOST_RANKS} and"
                f" {_MOST_SEGMENTS} segments can be packed"
            )
        _ = self.grid

    @classmethod
    def from_npz(cls, body: bytes) -> "Basis":
        """Read a basis from a body of `MEDIA_TYPE`.

        Raises:
            UnsupportedMap: If this version cannot make signatures for such a map, or the body is
                something else.
        """
        if not is_npz(body):
            raise UnsupportedMap(
                f"no map's basis: {len(body)} bytes that begin with {body[:16]!r}, wanted an .npz"
            )
        try:
            with np.load(io.BytesIO(body), allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            digest = str(arrays.pop("basis"))
            parameters = json.loads(str(arrays.pop("parameters")))
            arrays.pop("revision", None)
            least_cells = int(arrays.pop("least_cells", 0))
            return cls(digest, parameters, arrays, least_cells)
        except (AttributeError, KeyError, TypeError, ValueError, OSError, BadZipFile) as error:
            raise UnsupportedMap(f"the map's basis cannot be read: {error!r}") from error

    @property
    def grid(self) -> Grid:
        """The lattice of the map's images."""
        return Grid(self.parameters["grid"], self.parameters["reducer"])

    def encode(
        self,
        points: ArrayLike,
        *,
        sensor_height_m: float | None = None,
        mounting: Mounting | None = None,
        tilt: Tilt | None = None,
        min_returns: int = 1,
        all_numbers: bool = False,
    ) -> bytes:
        """Return a scan's packed signatures.

        Args:
            points: `(n, 3)` metres or more columns, in the sensor's frame; returns that are not
                finite or zero are left out.
            sensor_height_m: The sensor's height above ground, if it is not the map's.
            mounting: The sensor's mounting, in place of its height.
            tilt: The tilt of the vehicle, or of a sensor without mounting, if measured by gravity.
            min_returns: Least number of finite, non-zero returns.
            all_numbers: Whether to give it as many numbers as maps keep; a search of all maps needs
                them. Maps of full views, and of the paper's encoding, keep those of any signature.

        Raises:
            UnusableScan: If it has fewer returns, or nothing of it is in the map's image.
            TooFewCells: If fewer cells of the image than `least_cells` are occupied.
            InvalidArgument: As of `require_sensor`, or if the tilt is none.
        """
        height_m = float(self.parameters["sensor_height_m"])
        require_sensor(sensor_height_m, mounting)
        if not isinstance(tilt, Tilt | None):
            raise InvalidArgument(f"tilt is {tilt!r}, wanted a Tilt")
        xyz_m = returns(points)
        if xyz_m.shape[1] < min_returns:
            raise UnusableScan(
                f"{xyz_m.shape[1]} returns that are finite and not zero, at least {min_returns}"
                " wanted"
            )
        if mounting is not None:
            xyz_m = _mounted(xyz_m, mounting, height_m)
        elif sensor_height_m is not None:
            height_m = sensor_height_m
        if tilt is not None:
            xyz_m = _rounded(rotated(xyz_m, tilt.roll_deg, tilt.pitch_deg))
        if not xyz_m.size:
            raise UnusableScan("the scan has no return that is finite and not zero")
        cells, view = self._image(xyz_m, height_m, is_level=tilt is not None)
        occupied = int(np.count_nonzero(cells))
        if occupied < self.least_cells:
            raise TooFewCells(
                f"too few returns: {occupied} cells of the image are occupied, the map wants at"
                f" least {self.least_cells}"
            )
        if self.parameters["encoding"] == "harmonic":
            ranks = self._ranks(view, all_numbers=all_numbers)
            return pack_harmonic(self.digest, self._harmonic(cells, view, ranks), view)
        values = (
            self.arrays["elevation_basis"].transpose(0, 2, 1)
            @ cells.astype(np.float64)
            @ self.arrays["azimuth_basis"]
        )
        return pack_paper(self.digest, values.astype(np.float32), self.arrays["segments"].tolist())

    def _image(
        self, xyz_m: NDArray[np.float32], height_m: float, *, is_level: bool
    ) -> tuple[NDArray[np.float32], View]:
        """Return the image of a scan, and the part of it that the scan saw."""
        grid = self.grid
        if self.parameters.get("views", "full") == "full":
            return grid.project(xyz_m, height_m).cells, View()
        xyz_m = level(xyz_m, height_m, is_level=is_level)
        projected, sector = grid.project(xyz_m, height_m), grid.sector_of_column
        visible = projected.visible
        cells = np.where(visible[sector], projected.cells, np.float32(0.0))
        if not cells.any():
            raise UnusableScan(
                f"none of the scan's {xyz_m.shape[1]} returns is above ground where it sees"
            )
        hidden = tuple(np.unique(sector[~visible[sector]]).tolist())
        return cells, View(hidden, rings_in_reach(cells))

    def _ranks(self, view: View, *, all_numbers: bool) -> tuple[int, int]:
        """Return the ranks of a harmonic signature (signature.md, "Ranks")."""
        r1, r2 = self.parameters["ranks"]
        if self.parameters.get("views") != "any":
            return r1, r2
        kept_r1 = self.arrays["radial_basis"].shape[1]
        if all_numbers:
            return kept_r1, max(r2, min(_KEPT_HARMONICS, self.grid.shape[1] // 2))
        if view.is_narrow and r2 > max(r1, 6):
            return min(r1 + 2, kept_r1), r2 - 2
        return r1, r2

    def _harmonic(
        self, cells: NDArray[np.float32], view: View, ranks: tuple[int, int]
    ) -> NDArray[np.complex64]:
        """Return G = U^T S F, `(r1, r2)`; the first column is real."""
        r1, r2 = ranks
        columns = cells.shape[1]
        turns = np.outer(np.arange(columns), np.arange(r2)) % columns / columns
        factor = np.exp(-2j * math.pi * turns)
        factor.imag[2.0 * turns % 1.0 == 0.0] = 0.0  # f_0 and f_{J/2} are real
        factor = factor / math.sqrt(columns)
        u = self.arrays["radial_basis"][: view.rings, :r1].astype(np.float64)
        radial = u.T @ cells[: view.rings].astype(np.float64)
        values = radial @ factor.real + 1j * (radial @ factor.imag)
        return np.asarray(values, np.complex64)


def _mounted(
    xyz_m: NDArray[np.float32], mounting: Mounting, height_m: float
) -> NDArray[np.float32]:
    turned = rotated(xyz_m, mounting.roll_deg, mounting.pitch_deg, mounting.yaw_deg)
    return _rounded(turned + np.array([[mounting.x_m], [mounting.y_m], [mounting.z_m - height_m]]))


def _rounded(xyz_m: NDArray[np.float64]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # infinite then, and left out
        return without_others(xyz_m.astype(np.float32, order="C"))
