"""What a vehicle does with a scan in one map or in all of them: it is encoded, and then sent."""

import ssl
from collections.abc import Mapping
from typing import Any, TypedDict

import httpx2
from numpy.typing import ArrayLike

from tensormap_client._async.bases import AsyncBases
from tensormap_client._async.session import AsyncSession
from tensormap_client.io_async import computed
from tensormap_client.problems import StaleSignature
from tensormap_client.signature.basis import Basis, Mounting, Tilt, require_sensor

SIGNATURE_TYPE = "application/vnd.tensormap.signature"
MIN_RETURNS = 100  # TENSORMAP_MIN_RETURNS by default


class AsyncSensingOptions(TypedDict, total=False):
    """The options of `AsyncSensing`."""

    sensor_height_m: float | None
    mounting: Mounting | None
    min_returns: int
    timeout_s: float
    patience_s: float
    tls: ssl.SSLContext | None
    connections: httpx2.AsyncBaseTransport | None


class AsyncSensing(AsyncSession):
    """A sensor whose scans are sent as signatures.

    The arguments are those of `AsyncVehicle`, with the path of a basis in place of a map.
    """

    def __init__(
        self,
        url: str,
        key: str | None,
        basis_path: str,
        *,
        sensor_height_m: float | None = None,
        mounting: Mounting | None = None,
        min_returns: int = MIN_RETURNS,
        timeout_s: float = 5.0,
        patience_s: float = 10.0,
        tls: ssl.SSLContext | None = None,
        connections: httpx2.AsyncBaseTransport | None = None,
    ) -> None:
        require_sensor(sensor_height_m, mounting)
        super().__init__(
            url,
            key,
            timeout_s=timeout_s,
            patience_s=patience_s,
            tls=tls,
            connections=connections,
        )
        self._timeout_s = timeout_s
        self._bases = AsyncBases(self._transport, basis_path)
        self._basis: Basis | None = None  # that the next scan is encoded with
        self._sensor_height_m, self._mounting = sensor_height_m, mounting
        self._min_returns = min_returns

    async def _located(
        self,
        path: str,
        points: ArrayLike,
        tilt: Tilt | None,
        params: Mapping[str, Any],
        *,
        all_numbers: bool = False,
    ) -> tuple[Mapping[str, Any], Basis]:
        """Return the answer to a scan's signatures, and the basis; a stale one is downloaded again.

        Args:
            path: The route for signatures.
            points: The scan.
            tilt: The vehicle's tilt, if known.
            params: The query.
            all_numbers: As of `Basis.encode`.

        Raises:
            StaleSignature: If signatures made with the newest basis are stale too.
        """
        is_new = self._basis is None
        basis = self._basis or await self._bases.get()
        while True:
            body = await self._signatures(points, basis, tilt, all_numbers=all_numbers)
            try:
                answer = await self._transport.json(
                    "POST",
                    path,
                    content=body,
                    params=params,
                    headers={"Content-Type": SIGNATURE_TYPE},
                )
            except StaleSignature:
                renewed = None if is_new else await self._bases.get()
                if renewed is None or renewed.digest == basis.digest:
                    raise
                basis, is_new = renewed, True
                continue
            return answer, basis

    async def _signatures(
        self, points: ArrayLike, basis: Basis, tilt: Tilt | None, *, all_numbers: bool = False
    ) -> bytes:
        height_m, mounting = self._sensor_height_m, self._mounting
        return await computed(
            lambda: basis.encode(
                points,
                sensor_height_m=height_m,
                mounting=mounting,
                tilt=tilt,
                min_returns=self._min_returns,
                all_numbers=all_numbers,
            )
        )
