"""Scan files: one reader for each format, found by media type, suffix or magic."""
