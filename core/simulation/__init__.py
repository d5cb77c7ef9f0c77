"""Simulated worlds and the drives through them."""

from core.simulation.drive import SimulatedDrive

__all__ = ["SimulatedDrive"]
