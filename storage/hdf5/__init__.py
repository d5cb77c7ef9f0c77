"""HDF5: a strict reader, the only code that reads a file, and a writer over h5py.

The HDF5 library ends or stops its process on damaged bytes and on errors of the disk:
docs/decisions/0023-strict-hdf5.md.
"""

from storage.hdf5.dataset import ContiguousDataset, Dataset
from storage.hdf5.file import Hdf5File
from storage.hdf5.source import BytesSource, FileSource, Source

__all__ = ["BytesSource", "ContiguousDataset", "Dataset", "FileSource", "Hdf5File", "Source"]
