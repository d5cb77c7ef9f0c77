"""The images of a stored drive: kept beside it, or projected from its returns."""

import logging
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from app.drives.mapped_drives import digest_of, mapped_digest, mapped_drive
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.probe import displacement_of_probe
from core.scans.drive import Drive
from storage.catalog import CountedDrive
from storage.errors import CorruptImages, NotFound, ReturnsGone
from storage.files.image_file import (
    ImageFile,
    image_file_name,
    remove_other_versions,
    write_image_file,
)
from storage.store import Store, StoredDrive

_log = logging.getLogger("tensormap.builds")


def images_path(store: Store, drive: StoredDrive, parameters: MapParameters) -> Path:
    """Return where the images of a drive, as it is now, are kept for maps of these parameters.

    Raises:
        DriveNotFound: If the drive was deleted since it was opened.
    """
    name = image_file_name(parameters.imager, mapped_digest(drive, parameters.sensor_height_m))
    return store.drives.images_folder(drive.record) / name


def require_images(
    store: Store, map_id: str, drives: Sequence[str], parameters: MapParameters
) -> None:
    """Reject drives that have neither the images for these parameters nor all their returns.

    Raises:
        MapNotFound: If the map was deleted.
        DriveNotFound: If it lacks one of the drives.
        ReturnsGone: If the images of one can no longer be projected.
    """
    for drive in store.drives.counted(store.drives.of_map(map_id, drives)):
        if drive.scans_without_returns and not _path_unopened(store, drive, parameters).exists():
            raise _gone(drive.slug, drive.scans_without_returns, drive.scans)


def _path_unopened(store: Store, drive: CountedDrive, parameters: MapParameters) -> Path:
    """Return `images_path` of a drive, which is not opened: that reads all facts of its scans."""
    if drive.accumulate != 1:  # it depends on the poses too
        (opened,) = store.drives.open_of_map(drive.map_id, [drive.slug])
        return images_path(store, opened, parameters)
    digests = store.drives.digests(drive.id)
    digest = digest_of(drive, digests, None, parameters.sensor_height_m)
    return store.drives.images_folder(drive) / image_file_name(parameters.imager, digest)


def open_images(
    store: Store,
    drive: StoredDrive,
    parameters: MapParameters,
    progress: Progress = NO_PROGRESS,
) -> ImageFile:
    """Open a stored drive's images, projecting them first if they are not kept yet.

    Its probes are placed by the poses that it has now, as long as the returns are there.

    Raises:
        DriveNotFound: If the drive was deleted meanwhile.
        EmptyDrive: If it has no usable scan.
        ReturnsGone: If they are not kept, and some of the returns were dropped.
        CorruptImages: If they are damaged, and some of the returns were dropped.
    """
    path = images_path(store, drive, parameters)
    mapped = mapped_drive(drive, parameters.sensor_height_m)
    whole = bool(drive.has_returns.all())
    kept: ImageFile | None = None
    if path.exists():
        try:
            kept = ImageFile(path, parameters.imager)
            if kept.probes is not None and not (whole and _is_moved(kept, mapped, parameters)):
                return kept
        except CorruptImages as error:
            if not whole:
                raise CorruptImages(f"{error}; the returns were dropped after a build") from error
            _log.warning("%s; they are projected again from the raw returns", error)
    if not whole:
        if kept is None:
            raise _gone(drive.name, int((~drive.has_returns).sum()), len(drive))
        _log.warning("drive %s: its returns were dropped, and there are no probes", drive.name)
        return kept
    try:
        write_image_file(path, mapped, parameters.imager, progress)
    except (FileNotFoundError, NotFound):  # their map or drive was deleted
        if kept is not None:
            probes = "no probes" if kept.probes is None else "only probes of other poses"
            _log.warning("drive %s: its returns are gone, and there are %s", drive.name, probes)
            return kept
        store.maps.get_by_id(drive.map_id)
        store.drives.images_folder(drive.record)
        raise
    if kept is not None:
        kept.close()
    with ExitStack() as until_returned:
        # Open before anything else is done: a build of the drive as it is then removes the file.
        images = until_returned.enter_context(ImageFile(path, parameters.imager))
        (now,) = store.drives.open_of_map(drive.map_id, [drive.name])
        remove_other_versions(path, images_path(store, now, parameters))
        until_returned.pop_all()
    return images


def _is_moved(kept: ImageFile, mapped: Drive, parameters: MapParameters) -> bool:
    """Return whether probes are elsewhere than the drive's poses place them.

    Images do not depend on poses. Probes of a drive that got others, or its first ones, would give
    its map another calibration than it has where the drive came with them.
    """
    imager = parameters.imager
    if (kept.probed >= len(mapped)).any():  # damaged
        return True
    now = [displacement_of_probe(at, imager, mapped.poses, at) for at in kept.probed.tolist()]
    # Another processor rounds differently: that alone is not worth to project a drive again.
    return not np.allclose(np.reshape(now, (-1, 3)), kept.displacement, rtol=0.0, atol=1e-6)


def _gone(name: str, dropped: int, scans: int) -> ReturnsGone:
    return ReturnsGone(
        f"drive {name!r}: this build needs other images than were kept, and the returns of"
        f" {dropped} of {scans} scans were dropped after a build: build with the parameters of"
        " that one, or without this drive, or upload it again under another name"
    )
