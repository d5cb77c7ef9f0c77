"""Revisions of a map: load, import, compare, download."""
