"""TensorMap's method: numpy and scipy only, no files, no HTTP, no HDF5."""
