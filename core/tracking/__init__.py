"""Tracking: localization of a vehicle by its sequence of observations in a map's graph."""
