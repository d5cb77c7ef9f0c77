"""Tracking: a vehicle's sequence of observations in the graph of a map."""
