"""Simulated worlds and the drives through them."""

from core.simulation.city import make_city
from core.simulation.raycast import HDL_64E_BEAMS_DEG, SimulatedSensor, cast
from core.simulation.world import Boxes, Cylinders, Scene, Traffic, World

__all__ = [
    "HDL_64E_BEAMS_DEG",
    "Boxes",
    "Cylinders",
    "Scene",
    "SimulatedSensor",
    "Traffic",
    "World",
    "cast",
    "make_city",
]
