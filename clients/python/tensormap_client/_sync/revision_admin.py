# Made by make_sync.py: change _async instead.
"""Revisions and shared bases, as an administrator uses them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from tensormap_client._sync.download import download
from tensormap_client._sync.session import Session
from tensormap_client.answers import Answer
from tensormap_client.checks import require_several
from tensormap_client.io_sync import computed
from tensormap_client.paths import basis_path, map_path, revision_path

_HDF5 = "application/vnd.tensormap.map+hdf5"


class RevisionAdmin(Session):
    """Administers revisions and shared bases; `Admin` says what is raised."""

    def revisions(self, map_slug: str) -> Iterator[Answer]:
        """Yield a map's revisions, newest first."""
        return self._pages(f"{map_path(map_slug)}/revisions")

    def revision(self, map_slug: str, revision: str) -> Answer:
        """Return a revision."""
        return self._get(revision_path(map_slug, revision))

    def comparison(self, map_slug: str, revision: str, other: str | None = None) -> Answer:
        """Compare a revision and its recall with another one, the live one by default."""
        path = f"{revision_path(map_slug, revision)}/comparison"
        return self._get(path, None if other is None else {"with": other})

    def make_live(self, map_slug: str, revision: str) -> Answer:
        """Make a revision live, and return the map."""
        return self._sent("PUT", f"{map_path(map_slug)}/live", {"revision": revision})

    def delete_revision(self, map_slug: str, revision: str) -> None:
        """Remove a revision that is not live."""
        self._deleted(revision_path(map_slug, revision))

    def download_revision(self, map_slug: str, revision: str, file: Path | str) -> None:
        """Download a revision as its HDF5 file, in parts; a file of this name is replaced.

        Raises:
            OSError: If the file cannot be written.
        """
        path = f"{revision_path(map_slug, revision)}/file"
        download(self._transport, path, Path(file))

    def import_revision(
        self, map_slug: str, file: Path | str, *, make_live: bool = False
    ) -> Answer:
        """Import a revision from a map's file, and return it with its `gate` and `notes`.

        Args:
            map_slug: The map, which exists.
            file: The HDF5 file, as `download_revision` or `tensormap build` writes it. It is one
                body: the service's TENSORMAP_MAX_BODY_BYTES limits it.
            make_live: Whether it becomes live; the first revision of a map always does.

        Raises:
            OSError: If the file cannot be read.
        """
        answer = self._transport.json(
            "POST",
            f"{map_path(map_slug)}/revisions",
            content=computed(Path(file).read_bytes),
            params={"make_live": "true"} if make_live else None,
            headers={"Content-Type": _HDF5},
        )
        return dict(answer)

    def topology(self, map_slug: str, revision: str | None = None) -> Answer:
        """Return a revision as a graph of segments, the live one by default."""
        return self._of_revision(f"{map_path(map_slug)}/topology", revision)

    def geojson(self, map_slug: str, revision: str | None = None) -> Answer:
        """Return a revision of an anchored map as GeoJSON, the live one by default."""
        return self._of_revision(f"{map_path(map_slug)}/geojson", revision)

    def bases(self) -> Iterator[Answer]:
        """Yield the shared bases by name."""
        return self._pages("/v1/bases")

    def share_basis(self, name: str, maps: Sequence[str]) -> Answer:
        """Store a shared basis, and return it.

        Builds of any map use it with `{"basis": name}` among their parameters; such maps are then
        searched together by a `Locator`.

        Args:
            name: The basis's name.
            maps: The maps that it is made of: of one its live revision's basis, of several one that
                is fitted to all their drives.
        """
        require_several("maps", maps)
        return self._sent("POST", "/v1/bases", {"name": name, "maps": list(maps)})

    def delete_basis(self, name: str) -> None:
        """Remove a shared basis that no revision has and no build uses."""
        self._deleted(basis_path(name))

    def _of_revision(self, path: str, revision: str | None) -> Answer:
        return self._get(path, None if revision is None else {"revision": revision})
