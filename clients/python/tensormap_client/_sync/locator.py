# Made by make_sync.py: change _async instead.
"""A vehicle that does not know which map it is in."""

from typing import Unpack

from numpy.typing import ArrayLike

from tensormap_client._sync.bases import Bases
from tensormap_client._sync.sensing import Sensing, SensingOptions
from tensormap_client.answers import LocalizationInMaps
from tensormap_client.paths import basis_path, map_path
from tensormap_client.signature.basis import Basis, Tilt

_MOST = 8  # revisions whose wanted number of cells is kept: of maps beside each other


class Locator(Sensing):
    """A vehicle in any map of a shared basis; it sends some 250 bytes a scan.

    The basis is downloaded once, and again when none of the maps has it any more; how many cells of
    an image a map wants, when a scan is found in it first.
    Not for several threads or tasks at once.

    Args:
        url: The service's URL, for example `https://maps.example`.
        key: The API key, with scope `localize`; `None` if the service needs no key.
        basis: The shared basis's name or digest.
        options: Those of `Vehicle`, such as `sensor_height_m`.
    """

    def __init__(
        self, url: str, key: str | None, basis: str, **options: Unpack[SensingOptions]
    ) -> None:
        super().__init__(url, key, basis_path(basis), **options)
        self._found_in: dict[str, Basis] = {}  # by revision, the last used one last

    def locate(
        self,
        points: ArrayLike,
        *,
        tilt: Tilt | None = None,
        k: int = 1,
        min_probability: float | None = None,
    ) -> LocalizationInMaps:
        """Return in which map a scan was recorded, and where.

        Args:
            points: The scan, `(n, 3)` or more columns, in metres; returns that are not finite or
                zero are left out.
            tilt: The vehicle's tilt, if it is measured against gravity.
            k: Number of matches to return.
            min_probability: Lowest probability to accept, if not the best map's.

        Raises:
            UnusableScan: If the scan has too few returns, or nothing of it is in the maps' image.
            TooFewCells: If it was found, but too little of it is in the image for that map.
            UnsupportedMap: If this version cannot make signatures with the basis.
            Unreachable: If the service does not answer.
            Rejected: If the service rejects the query; the subclass gives the reason.
        """
        params = {} if min_probability is None else {"min_probability": min_probability}
        answer, self._basis = self._located(
            "/v1/localizations/signature", points, tilt, {"k": k, **params}, all_numbers=True
        )
        found = LocalizationInMaps.from_json(answer)
        if found.localized:
            # A shared basis is of no map: only now it is known how many cells are wanted.
            self._signatures(points, self._basis_in(found.map, found.best.revision), tilt)
        return found

    def _basis_in(self, map_slug: str, revision: str) -> Basis:
        """Return the basis of a map's revision, which has the `least_cells` of that."""
        basis = self._found_in.pop(revision, None)
        if basis is None:
            bases = Bases(self._transport, f"{map_path(map_slug)}/basis")
            basis = bases.get(revision)
        self._found_in[revision] = basis
        if len(self._found_in) > _MOST:
            del self._found_in[next(iter(self._found_in))]
        return basis
