"""Captures and bags that are uploaded in parts, and read into the scans of a drive."""
