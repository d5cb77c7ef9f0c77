"""Checks of proposed loop closures."""
