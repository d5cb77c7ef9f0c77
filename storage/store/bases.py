"""Shared bases: immutable files and the rows that name them."""

from core.encodings.basis import Basis
from core.errors import InvalidParameters
from storage.catalog import BasisRecord, Catalog
from storage.errors import CorruptFile
from storage.files.basis_file import read_basis, write_basis
from storage.files.files import (
    discard,
    discarded_on_rollback,
    make_folder,
    named_disk_errors,
    publish,
    sync,
)
from storage.files.free_space import OF_SCANS
from storage.files.place_files import PlaceFiles
from storage.names import new_id
from storage.store.layout import Layout


class Bases:
    """The shared bases by name; methods that only read rows are the catalog's."""

    def __init__(self, catalog: Catalog, layout: Layout) -> None:
        self._catalog = catalog
        self._layout = layout
        self.get = catalog.bases.get
        self.list = catalog.bases.list

    def add(self, name: str, basis: Basis) -> tuple[BasisRecord, bool]:
        """Write a basis's file and add its row; return the record, and whether it is new.

        Raises:
            InvalidSlug: If `name` is not a valid slug.
            InvalidParameters: If each segment of a map of this encoding has bases of its own.
            BasisExists: If another basis has the name, or this one has another name.
            StorageFull: If no space is left; nothing is changed.
        """
        if not basis.parameters.encoder.shares_basis:
            raise InvalidParameters(
                f"a {basis.parameters.encoding} map has bases of its own for each segment; they"
                " cannot be shared"
            )
        file_name = f"{basis.digest}.{new_id()[:8]}.h5"
        path = make_folder(self._layout.bases) / file_name
        with discarded_on_rollback(path):
            with publish(path) as part:
                write_basis(part, basis)
                OF_SCANS.require_kept(part.parent, "the basis")
                size_bytes = part.stat().st_size
            record = self._catalog.bases.add(
                name, basis.digest, file_name, basis.parameters.encoding, size_bytes
            )
        if record.file_name == file_name:
            return record, True
        with named_disk_errors():  # the first one may be damaged, this one was just read back
            path.replace(self._layout.bases / record.file_name)
            sync(path.parent)
        return record, False

    def read(self, named: str) -> Basis:
        """Return a basis by its name, its digest or at least 12 first digits of that.

        Raises:
            BasisNotFound: If there is none.
            CorruptFile: If its file is gone or damaged.
        """
        record = self.get(named)
        try:
            return read_basis(self._layout.bases / record.file_name, record.digest)
        except FileNotFoundError as error:
            self.get(named)  # perhaps deleted meanwhile
            self._catalog.require_writable()  # it may be the whole folder that is gone
            raise CorruptFile(f"the file of shared basis {record.name!r} is gone") from error

    def delete(self, named: str) -> BasisRecord:
        """Remove a basis that nothing uses: its row, then its file and index.

        Raises:
            BasisNotFound: If there is none.
            BasisInUse: If a revision has it, or a queued or running job will use it.
        """
        record = self._catalog.bases.delete(named)
        discard(self._layout.bases / record.file_name)
        PlaceFiles(self._layout.index / record.digest).remove()
        return record
