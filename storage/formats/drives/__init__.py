"""Recorded drives: one reader for each layout of folders and captures."""
