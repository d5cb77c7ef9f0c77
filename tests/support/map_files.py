"""Map files, where they are and what came to them."""

import h5py

from core.errors import TensorMapError
from storage.files.map_file import read_map


def revision_file(store, slug, digest):
    """Return the path of a revision's file; the digest may be a prefix of it."""
    return store.revisions.path_of(store.revisions.get(slug, digest))


def whole_or_rejected(path, revision):
    """Read; return whether it was rejected. Any other exception or map is a failure."""
    try:
        again = read_map(path)
    except TensorMapError:
        return True
    assert again.revision == revision
    return False


def replaced(path, name, array, **options):
    with h5py.File(path, "r+") as file:
        del file[name]
        if array is not None:
            file.create_dataset(name, data=array, **options)
