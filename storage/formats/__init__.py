"""Readers of scan files and of recorded drives: bytes and folders to core's types."""
