"""The bases that one path returns, each downloaded once."""

from dataclasses import replace

from tensormap_client._async.transport import AsyncTransport
from tensormap_client.errors import Unreachable
from tensormap_client.signature.basis import MEDIA_TYPE, Basis, is_npz

_LEAST_CELLS = "TensorMap-Least-Cells"
_MOST = 8  # of a map that is rebuilt with another basis each time


class AsyncBases:
    """Downloads bases with `If-None-Match`: revisions with the same basis cost it once.

    Args:
        transport: The connections to the service.
        path: The path of a map's basis, or of a shared one.
    """

    def __init__(self, transport: AsyncTransport, path: str) -> None:
        self._transport, self._path = transport, path
        self._held: dict[str, Basis] = {}  # by ETag, the last used one last

    async def get(self, revision: str | None = None, patience_s: float | None = None) -> Basis:
        """Return the basis of a map's revision, of the live one by default, or the shared one.

        Args:
            revision: The revision's digest.
            patience_s: How long a failed request is retried, if not as long as the transport's.

        Raises:
            UnsupportedMap: If this version cannot make signatures with the basis.
            Unreachable: If the service does not answer, or another one does.
            ClientError: If the service has no such basis.
        """
        headers = {"Accept": MEDIA_TYPE}
        if self._held:
            headers["If-None-Match"] = ", ".join(self._held)
        answer = await self._transport.request(
            "GET",
            self._path,
            headers=headers,
            params=None if revision is None else {"revision": revision},
            patience_s=patience_s,
            is_download=True,
        )
        tag = answer.headers.get("ETag", "")
        if is_npz(answer.content):
            basis = Basis.from_npz(answer.content)
        elif not answer.content and tag in self._held:
            basis = self._held.pop(tag)
        else:  # as of another service, or of a cache that forgot it
            kind = answer.headers.get("Content-Type", "no type")
            raise Unreachable(
                f"there is no TensorMap service: GET {self._path} sent no basis, but"
                f" {len(answer.content)} bytes of {kind[:80]}"
            )
        least_cells = answer.headers.get(_LEAST_CELLS, "")
        if least_cells.isdecimal():  # revisions with one basis differ in it
            basis = replace(basis, least_cells=int(least_cells))
        self._held[tag] = basis
        if len(self._held) > _MOST:
            del self._held[next(iter(self._held))]
        return basis
