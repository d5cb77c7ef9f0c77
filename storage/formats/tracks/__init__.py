"""Tracks of GNSS receivers: one reader for each format."""
