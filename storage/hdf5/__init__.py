"""HDF5 without the HDF5 library: a strict reader, and a writer of what it reads.

The library ends or stops its process on damaged bytes and loses errors of the disk:
docs/decisions/0023-strict-hdf5.md.
"""

from storage.hdf5.dataset import ChunkedDataset, ContiguousDataset, Dataset
from storage.hdf5.file import Hdf5File
from storage.hdf5.source import BytesSource, FileSource, Source
from storage.hdf5.writer import ChunkWriter, Hdf5Writer

__all__ = [
    "BytesSource",
    "ChunkWriter",
    "ChunkedDataset",
    "ContiguousDataset",
    "Dataset",
    "FileSource",
    "Hdf5File",
    "Hdf5Writer",
    "Source",
]
