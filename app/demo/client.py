"""The requests of the demonstration's vehicles, which compare their kinds."""

from typing import Any

import httpx2

from app.demo.errors import DemoFailed
from app.localization.schemas import LocalizationOut
from app.revisions.schemas import BasisOut
from app.revisions.topology_schemas import TopologyOut

_TYPES = {
    "scan": "application/vnd.tensormap.kitti",
    "signature": "application/vnd.tensormap.signature",
}


class DemoClient(httpx2.Client):
    """A connection to a service, for one map."""

    def __init__(self, url: str, map_slug: str) -> None:
        super().__init__(base_url=url, timeout=60.0, trust_env=False)  # no proxy reaches it
        self._map = f"/v1/maps/{map_slug}"

    def mapped_scans(self) -> int:
        """Return the number of scans of the live revision."""
        live = self._checked("GET", self._map).json()["live_revision"]
        scans: int = self._checked("GET", f"{self._map}/revisions/{live}").json()["scans"]
        return scans

    def basis(self) -> BasisOut:
        """Download the basis."""
        return BasisOut.model_validate_json(self._checked("GET", f"{self._map}/basis").content)

    def topology(self) -> TopologyOut:
        """Download the graph."""
        return TopologyOut.model_validate_json(
            self._checked("GET", f"{self._map}/topology").content
        )

    def localize(self, kind: str, body: bytes) -> LocalizationOut:
        """Localize a scan or packed signatures.

        Args:
            kind: `scan` or `signature`.
            body: The request's body.
        """
        answer = self._checked(
            "POST",
            f"{self._map}/localizations/{kind}",
            content=body,
            headers={"Content-Type": _TYPES[kind]},
        )
        return LocalizationOut.model_validate_json(answer.content)

    def _checked(self, method: str, path: str, **parts: Any) -> httpx2.Response:  # noqa: ANN401
        try:
            answer = self.request(method, path, **parts)
        except httpx2.TransportError as error:
            raise DemoFailed(f"{method} {path}: {str(error) or repr(error)}") from error
        if not answer.is_success:
            raise DemoFailed(f"{method} {path}: {answer.status_code} {answer.text}")
        return answer
