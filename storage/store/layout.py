"""The layout of the data directory; paths are built from ids, never from a client's names.

catalog.sqlite3
store-id                                       the same as in the catalog
server.lock                                    held by the one server of this directory
maps/<map id>/drives/<drive id>/chunks/*.h5    raw scans
maps/<map id>/drives/<drive id>/images/        what builds cache
maps/<map id>/revisions/<digest>.<id>.h5
orphans/<day>/maps/...                         files that no row names, found at a start
damaged/<day>/maps/...                         damaged files, found by a repair
"""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Layout:
    """The paths under one data directory."""

    data_dir: Path

    @property
    def catalog(self) -> Path:
        """The default catalog's file."""
        return self.data_dir / "catalog.sqlite3"

    @property
    def lock(self) -> Path:
        """The file that the server of this directory holds locked."""
        return self.data_dir / "server.lock"

    @property
    def store_id(self) -> Path:
        """The file with the id that this directory shares with its catalog."""
        return self.data_dir / "store-id"

    @property
    def orphans(self) -> Path:
        """The folder of files that no row names, under their former paths."""
        return self.data_dir / "orphans"

    @property
    def damaged(self) -> Path:
        """The folder of damaged files that a repair moved, under their former paths."""
        return self.data_dir / "damaged"

    @property
    def folders(self) -> tuple[Path, ...]:
        """All folders that a data directory may have."""
        return self.maps, self.orphans, self.damaged

    @property
    def maps(self) -> Path:
        """The folder with one folder per map."""
        return self.data_dir / "maps"

    def map(self, map_id: str) -> Path:
        """All that belongs to a map."""
        return self.maps / map_id

    def drive(self, map_id: str, drive_id: str) -> Path:
        """All that belongs to a drive."""
        return self.map(map_id) / "drives" / drive_id

    def chunks(self, map_id: str, drive_id: str) -> Path:
        """The folder of a drive's chunk files."""
        return self.drive(map_id, drive_id) / "chunks"

    def images(self, map_id: str, drive_id: str) -> Path:
        """The folder of what builds cache of a drive."""
        return self.drive(map_id, drive_id) / "images"

    def revisions(self, map_id: str) -> Path:
        """The folder of a map's revisions."""
        return self.map(map_id) / "revisions"
