"""The harmonic encoding: one radial basis for the whole map, circular harmonics in azimuth."""
