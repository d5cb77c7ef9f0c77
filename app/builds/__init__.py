"""Builds: planned, done, and compared with the live revision."""
