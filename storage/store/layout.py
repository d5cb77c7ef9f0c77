"""The layout of the data directory; paths are built from ids, never from a client's names.

catalog.sqlite3
catalog.sqlite3-tracks                         what running tracks need after a restart
store-id                                       the same as in the catalog
clock.json                                     when the clock was last looked at
scrub.json                                     how far the service has checked the files
server.lock                                    held by the one server of this directory
maps/<map id>/drives/<drive id>/chunks/*.h5    raw scans
maps/<map id>/drives/<drive id>/images/        what builds cache
maps/<map id>/captures/<id>/<part>.<id>.bin    captures in parts, until they are read
maps/<map id>/revisions/<digest>.<id>.h5
bases/<digest>.<id>.h5                         shared bases
index/<basis>/...                              indexes of places, made of the revisions
orphans/<day>/maps/...                         files that no row names, found at a start
damaged/<day>/maps/...                         damaged files, found by a repair
"""

from pathlib import Path

CATALOG, STORE_ID = "catalog.sqlite3", "store-id"
"""Names of files, also in a backup."""

ANY_IMAGES = "*.h5"
"""What is missing in the folder of images of a drive that lacks returns, and has none."""


class Layout:
    """The paths under one data directory.

    Attributes:
        data_dir: The data directory.
        catalog: The default catalog's file.
        tracks: The file of the tracks, where the catalog is the default one.
        lock: The file that the server of this directory holds locked.
        clock: The file that shows a start whether the clock was set meanwhile.
        store_id: The file with the id that this directory shares with its catalog.
        maps: The folder with one folder per map.
        bases: The folder of the files of shared bases.
        index: The folder of indexes of places, which are made again if they are missing.
        orphans: The folder of files that no row names, under their former paths.
        damaged: The folder of damaged files that a repair moved, under their former paths.
    """

    def __init__(self, data_dir: Path) -> None:
        self.data_dir = data_dir
        self.catalog = data_dir / CATALOG
        self.tracks = data_dir / f"{self.catalog.name}-tracks"
        self.lock = data_dir / "server.lock"
        self.clock = data_dir / "clock.json"
        self.store_id = data_dir / STORE_ID
        self.maps = data_dir / "maps"
        self.bases = data_dir / "bases"
        self.index = data_dir / "index"
        self.orphans = data_dir / "orphans"
        self.damaged = data_dir / "damaged"

    @property
    def has_catalog(self) -> bool:
        """Whether the catalog is here, and in no database elsewhere."""
        return self.catalog.exists()

    @property
    def of_disks(self) -> tuple[Path, Path]:
        """A folder of each disk: `maps/` may be a link to another one, or its mount point."""
        return self.maps, self.data_dir

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

    def captures(self, map_id: str) -> Path:
        """The folder of the captures that are uploaded for a map's drives."""
        return self.map(map_id) / "captures"

    def capture(self, map_id: str, capture_id: str) -> Path:
        """The folder of a capture's parts."""
        return self.captures(map_id) / capture_id
