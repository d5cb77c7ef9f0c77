"""Shared bases: stored objects, which builds of any map can use."""
