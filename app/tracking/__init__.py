"""Tracking: a vehicle's observations, one after another."""
