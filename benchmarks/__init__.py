"""Measurements with bars; `make bench` runs them all."""
