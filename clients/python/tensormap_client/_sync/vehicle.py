# Made by make_sync.py: change _async instead.
"""A vehicle: localizes its scans in one map."""

from typing import Unpack

from numpy.typing import ArrayLike

from tensormap_client._sync.sensing import Sensing, SensingOptions
from tensormap_client._sync.track import Track
from tensormap_client.answers import Localization
from tensormap_client.checks import require_slug
from tensormap_client.paths import map_path
from tensormap_client.prior import Prior, require_prior
from tensormap_client.signature.basis import Basis, Tilt


class Vehicle(Sensing):
    """A vehicle in one map; it sends signatures, some 60 to 100 bytes a scan in place of megabytes.

    An object is for one thread or task at a time.

    Args:
        url: The service's URL, for example `https://maps.example`.
        key: The API key, with scope `localize`; `None` if the service needs no key.
        map_slug: The map.
        sensor_height_m: The sensor's height above ground, if it is not the map's.
        mounting: The sensor's mounting, in place of its height; answers then give the vehicle's
            pose.
        min_returns: Least number of returns; a scan with fewer is not sent. By default 100, as of
            the service.
        timeout_s: How long to wait for an answer, and then for all of it, in seconds; 5 by default.
        patience_s: How long `locate` retries a failed request, in seconds; 10 by default. Where the
            service has not answered this object before, a lost connection is not retried.
        tls: How to check the service's certificate, if not against the system's authorities.
        connections: HTTP transport to use instead of the network; streams do not use it.
    """

    def __init__(
        self, url: str, key: str | None, map_slug: str, **options: Unpack[SensingOptions]
    ) -> None:
        require_slug("the map", map_slug)
        self._map = map_path(map_slug)
        self._answered: str | None = None  # revision
        super().__init__(url, key, f"{self._map}/basis", **options)

    def locate(
        self,
        points: ArrayLike,
        *,
        tilt: Tilt | None = None,
        k: int = 1,
        min_probability: float | None = None,
        **prior: Unpack[Prior],
    ) -> Localization:
        """Return where a scan was recorded.

        Args:
            points: The scan, `(n, 3)` or more columns, in metres; returns that are not finite or
                zero are left out.
            tilt: The vehicle's tilt, if it is measured against gravity.
            k: Number of matches to return.
            min_probability: Lowest probability to accept, if not the map's.
            prior: What is known of the place, for example `x_m`, `y_m` and `position_sigma_m`: see
                `Prior`.

        Raises:
            TypeError: If an argument has another name.
            InvalidArgument: If a value of the prior is `None`, or it names no segment at all.
            UnusableScan: If the scan has too few returns, or nothing of it is in the map's image.
            TooFewCells: If too little of it is: such a scan is refused, and is not sent.
            UnsupportedMap: If this version cannot make signatures for the map.
            Unreachable: If the service does not answer.
            Rejected: If the service rejects the query; the subclass gives the reason.
        """
        require_prior(prior)
        params: dict[str, object] = {"k": k, **prior}
        if min_probability is not None:
            params["min_probability"] = min_probability
        path = f"{self._map}/localizations/signature"
        held = self._basis
        answer, basis = self._located(path, points, tilt, params)
        found = Localization.from_json(answer)
        # The live revision has another basis, or another `least_cells`: it is for the next scan.
        is_of_live = found.revision == found.live_revision and (
            basis is not held or found.revision == self._answered
        )
        self._basis, self._answered = basis if is_of_live else None, found.revision
        return found

    def basis(self) -> Basis:
        """Return the basis of the live revision.

        Raises:
            UnsupportedMap: If this version cannot make signatures with the basis.
            ClientError: If the service cannot be reached or has no such revision.
        """
        return self._bases.get()

    def track(self) -> Track:
        """Return a new track of this vehicle; its first `observe` asks the service."""
        return Track(self._transport, self._bases, self._map, self._signatures, self._timeout_s)
