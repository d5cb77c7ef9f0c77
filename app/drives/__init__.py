"""Drives: uploads of scans and poses, and the images made of them."""
