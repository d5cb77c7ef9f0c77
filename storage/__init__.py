"""Bytes to and from the method's types: HDF5 files, scan formats and the catalog."""
