"""Backups of a data directory, and restores."""
