# Made by make_sync.py: change _async instead.
"""A vehicle that does not know which map it is in."""

from typing import Unpack

from numpy.typing import ArrayLike

from tensormap_client._sync.sensing import Sensing, SensingOptions
from tensormap_client.answers import LocalizationInMaps
from tensormap_client.paths import basis_path
from tensormap_client.signature.basis import Tilt


class Locator(Sensing):
    """A vehicle in one of all maps of a shared basis; it sends some 250 bytes a scan.

    The basis is downloaded once, and again when none of the maps has it any more.
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
            UnsupportedMap: If this version cannot make signatures with the basis.
            Unreachable: If the service does not answer.
            Rejected: If it rejects the query; a subclass says why.
        """
        params = {} if min_probability is None else {"min_probability": min_probability}
        answer, self._basis = self._located(
            "/v1/localizations/signature", points, tilt, {"k": k, **params}, all_numbers=True
        )
        return LocalizationInMaps.from_json(answer)
