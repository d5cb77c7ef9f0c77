"""A vehicle: what it sees becomes a place."""

import ssl

import httpx2
from numpy.typing import ArrayLike

from tensormap_client._async.bases import AsyncBases
from tensormap_client._async.session import AsyncSession
from tensormap_client._async.track import AsyncTrack
from tensormap_client.answers import Localization
from tensormap_client.errors import InvalidArgument
from tensormap_client.io_async import computed
from tensormap_client.paths import map_path
from tensormap_client.problems import StaleSignature
from tensormap_client.signature.basis import Basis, Mounting, Tilt

SIGNATURE_TYPE = "application/vnd.tensormap.signature"
MIN_RETURNS = 100  # TENSORMAP_MIN_RETURNS by default


class AsyncVehicle(AsyncSession):
    """A vehicle in one map; it sends signatures, some 60 to 100 bytes a scan in place of megabytes.

    Not for several threads or tasks at once.

    Args:
        url: Of the service, as `https://maps.example`.
        key: With scope `localize`; `None` if the service needs none.
        map_slug: The map.
        sensor_height_m: Of the sensor above ground, if it is not the map's.
        mounting: Of the sensor, in place of its height; answers are then the vehicle's pose.
        min_returns: A scan of fewer is not sent; the service's default for scans.
        timeout_s: For so long an answer is waited for.
        patience_s: For so long `locate` repeats a request that cannot be answered.
        tls: How the service's certificate is checked, if not as usual.
        connections: Instead of those over the network, but for streams.
    """

    def __init__(
        self,
        url: str,
        key: str | None,
        map_slug: str,
        *,
        sensor_height_m: float | None = None,
        mounting: Mounting | None = None,
        min_returns: int = MIN_RETURNS,
        timeout_s: float = 5.0,
        patience_s: float = 10.0,
        tls: ssl.SSLContext | None = None,
        connections: httpx2.AsyncBaseTransport | None = None,
    ) -> None:
        if mounting is not None and sensor_height_m is not None:
            raise InvalidArgument("a mounting has a height: leave sensor_height_m out")
        super().__init__(
            url,
            key,
            timeout_s=timeout_s,
            patience_s=patience_s,
            tls=tls,
            connections=connections,
        )
        self._timeout_s = timeout_s
        self._map = map_path(map_slug)
        self._bases = AsyncBases(self._transport, map_slug)
        self._basis: Basis | None = None
        self._sensor_height_m, self._mounting = sensor_height_m, mounting
        self._min_returns = min_returns

    async def locate(
        self,
        points: ArrayLike,
        *,
        tilt: Tilt | None = None,
        k: int = 1,
        min_probability: float | None = None,
        **prior: float | str | list[int],
    ) -> Localization:
        """Return where a scan was recorded.

        Args:
            points: `(n, 3)` metres or more columns; what is not finite or zero is left out.
            tilt: Of the vehicle, if known by gravity.
            k: How many matches are wanted.
            min_probability: Least one to accept, if not the map's own.
            prior: What is known of the place, as `x_m`, `y_m` and `position_sigma_m`: the query
                parameters of `POST .../localizations/signature`.

        Raises:
            UnusableScan: If the scan has too few returns, or nothing of it is in the map's image.
            UnsupportedMap: If this version cannot make signatures for the map.
            Unreachable: If the service does not answer.
            Rejected: If it rejects the query; a subclass says why.
        """
        params = {"k": k, **prior}
        if min_probability is not None:
            params["min_probability"] = min_probability
        fresh = self._basis is None
        basis = self._basis or await self._bases.get()
        while True:
            body = await self._signed(points, basis, tilt)
            try:
                answer = await self._transport.json(
                    "POST",
                    f"{self._map}/localizations/signature",
                    content=body,
                    params=params,
                    headers={"Content-Type": SIGNATURE_TYPE},
                )
            except StaleSignature:
                if fresh:
                    raise
                basis, fresh = await self._bases.get(), True
                continue
            found = Localization.from_json(answer)
            # The live revision has another basis: the next scan is compared with that.
            self._basis = basis if found.revision == found.live_revision else None
            return found

    async def basis(self) -> Basis:
        """Return the basis of the live revision.

        Raises:
            UnsupportedMap: If this version cannot make signatures with it.
            ClientError: If the service cannot be reached or has no such revision.
        """
        return await self._bases.get()

    def track(self) -> AsyncTrack:
        """Return a new track of this vehicle; the service is first asked by its `observe`."""
        return AsyncTrack(self._transport, self._bases, self._map, self._signed, self._timeout_s)

    async def _signed(self, points: ArrayLike, basis: Basis, tilt: Tilt | None) -> bytes:
        height_m, mounting = self._sensor_height_m, self._mounting
        return await computed(
            lambda: basis.sign(
                points,
                sensor_height_m=height_m,
                mounting=mounting,
                tilt=tilt,
                min_returns=self._min_returns,
            )
        )
