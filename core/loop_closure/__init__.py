"""Checks of proposed loop closures (paper, sec. 4)."""
