"""Checks every file that the catalog names against its digest; a repair moves damaged ones."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from itertools import chain

from core.progress import NO_PROGRESS, Progress
from storage.errors import DataDirInUse, StorageError, StorageReadOnly, with_cause
from storage.files.checker import Checker
from storage.files.files import discard
from storage.files.stored_file import Fault, StoredFile
from storage.store.compaction import in_chunks, move_into_one
from storage.store.inventory import Inventory
from storage.store.leftovers import leftovers, set_aside, sweep
from storage.store.scan_reader import ScanReader
from storage.store.store import Store


class Condition(StrEnum):
    """What is wrong with a file."""

    DAMAGED = "damaged"
    MISSING = "missing"
    UNREADABLE = "unreadable"
    LEFT_OVER = "left over"


@dataclass(frozen=True)
class Finding:
    """What is wrong with a file, and what was done about it.

    Attributes:
        condition: Damaged or missing; unreadable if it may be good; or left over.
        path: Path under the data directory.
        what: A description of the fault.
        done: What a repair did, empty if nothing.
        is_loss: Whether something that the catalog names can neither be read nor made again.
        described: A description of the file for users; empty if the catalog does not name it.
    """

    condition: Condition
    path: str
    what: str
    done: str = ""
    is_loss: bool = True
    described: str = ""


@dataclass(frozen=True)
class Verification:
    """The result of a verification.

    Attributes:
        files: Number of files that were checked.
        findings: The faults, leftovers last.
    """

    files: int
    findings: tuple[Finding, ...]

    @property
    def is_whole(self) -> bool:
        """Whether all that the catalog names can be read."""
        return not any(finding.is_loss for finding in self.findings)


def verify(store: Store, *, repair: bool = False, progress: Progress = NO_PROGRESS) -> Verification:
    """Check every file that the catalog names, and find files that it does not name.

    The service may run meanwhile. A repair owns the data directory while it runs: it moves damaged
    files to `damaged/`, so that all others can be read, and sweeps as a start does. It removes
    nothing but half-written files, old orphans, and cached images that a build makes again.

    Args:
        store: The store.
        repair: Whether to move damaged files, and to sweep.
        progress: Reports every file.

    Raises:
        DataDirInUse: If a server runs, and `repair` is set.
    """
    if not repair:
        return _verify(store, progress, repair=False)
    with store.owned():
        return _verify(store, progress, repair=True)


def _verify(store: Store, progress: Progress, *, repair: bool) -> Verification:
    inventory = Inventory(store.catalog, store.layout)
    findings = [Finding(Condition.DAMAGED, "catalog", what) for what in store.catalog.faults()]
    slugs = cache(store.catalog.drives.slugs_by_id)
    progress.start("files", len(inventory.paths()))
    checked = 0
    with Checker() as checker:
        for file in inventory.files():
            progress.advance()
            checked += 1
            try:
                fault = inventory.fault(file, checker)
            except FileNotFoundError:
                described = file.described(slugs())
                findings.append(
                    Finding(Condition.MISSING, file.path, "the file is gone", described=described)
                )
                continue
            if fault is not None:
                found = Condition.DAMAGED if fault.certain else Condition.UNREADABLE
                described = file.described(slugs(), fault.good_rows)
                finding = Finding(found, file.path, fault.what, described=described)
                findings.append(_repaired(store, file, fault, finding) if repair else finding)
    return Verification(checked, tuple(chain(findings, _left_over(store, repair=repair))))


def _left_over(store: Store, *, repair: bool) -> Iterator[Finding]:
    catalog, layout = store.catalog, store.layout
    if repair:
        found = sweep(catalog, layout, store.clock)
    else:
        try:
            with store.owned():
                found = leftovers(catalog, layout, alone=True)
        except (DataDirInUse, StorageReadOnly):
            found = leftovers(catalog, layout, alone=False)
    for item in found:
        path = str(item.path.relative_to(layout.data_dir))
        yield Finding(Condition.LEFT_OVER, path, item.what, item.done, is_loss=False)


def _repaired(store: Store, file: StoredFile, fault: Fault, finding: Finding) -> Finding:
    """Move a damaged file to `damaged/`, and the good scans in it into another file."""
    if not fault.certain:
        return finding
    path = store.layout.data_dir / file.path
    if file.kind == "images" and not store.catalog.scans.lacks_returns(file.drive_id):
        discard(path)
        return replace(finding, done="removed: a build makes it again", is_loss=False)
    saved = ""
    try:
        if fault.good_rows:
            _save(store, file, fault.good_rows)
            saved = f"; {len(fault.good_rows)} good scans have a new file"
        aside = set_aside(path, store.layout, store.layout.damaged)
    except (StorageError, OSError) as error:  # until it is moved its good rows can be read
        return replace(finding, done=f"left as it is: {with_cause(error)}")
    return replace(finding, done=f"moved to {aside.relative_to(store.layout.data_dir)}{saved}")


def _save(store: Store, file: StoredFile, rows: tuple[int, ...]) -> None:
    """Move the scans of these rows into new files; each is checked against its digest again."""
    good = set(rows)
    in_file = store.catalog.scans.of_chunk(file.drive_id, file.name)
    records = [record for record in in_file if record.row in good]
    drive = store.catalog.drives.with_id(file.drive_id)
    chunks = store.layout.chunks(file.map_id, file.drive_id)
    read = ScanReader(store.catalog, drive, chunks).scan
    for group in in_chunks(records):
        move_into_one(store.catalog, file.drive_id, chunks, group, read)
