"""Revisions: loaded, imported, compared, downloaded."""
