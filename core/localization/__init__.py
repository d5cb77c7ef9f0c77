"""Localization: the best match in a map, refined to a pose (paper, sec. 2.3)."""
