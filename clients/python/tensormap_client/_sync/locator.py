# Made by make_sync.py: change _async instead.
"""A vehicle that does not know which map it is in."""

from typing import Unpack

from numpy.typing import ArrayLike

from tensormap_client._sync.bases import Bases
from tensormap_client._sync.sensing import Sensing, SensingOptions
from tensormap_client.answers import LocalizationInMaps
from tensormap_client.paths import basis_path, map_path
from tensormap_client.signature.basis import Basis, Tilt


class Locator(Sensing):
    """A vehicle in one of all maps of a shared basis; it sends some 250 bytes a scan.

    The basis is downloaded once, and again when none of the maps has it any more; how many cells of
    an image a map wants, when a scan was found in it.
    Not for several threads or tasks at once.

    Args:
        url: Of the service, as `https://maps.example`.
        key: With scope `localize`; `None` if the service needs none.
        basis: Name of the shared basis, or its digest.
        options: As of `Vehicle`.
    """

    def __init__(
        self, url: str, key: str | None, basis: str, **options: Unpack[SensingOptions]
    ) -> None:
        super().__init__(url, key, basis_path(basis), **options)
        self._found_in: tuple[str, Basis] | None = None  # the revision found last, and its basis

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
            points: `(n, 3)` metres or more columns; what is not finite or zero is left out.
            tilt: Of the vehicle, if known by gravity.
            k: How many matches are wanted.
            min_probability: Least one to accept, if not that of the best map.

        Raises:
            UnusableScan: If the scan has too few returns, or nothing of it is in the maps' image.
            TooFewCells: If it was found, but too little of it is in the image for that map.
            UnsupportedMap: If this version cannot make signatures with the basis.
            Unreachable: If the service does not answer.
            Rejected: If it rejects the query; a subclass says why.
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
        if self._found_in is None or self._found_in[0] != revision:
            bases = Bases(self._transport, f"{map_path(map_slug)}/basis")
            self._found_in = revision, bases.get(revision)
        return self._found_in[1]
