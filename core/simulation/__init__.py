"""Simulated worlds and the drives through them."""

from core.simulation.city import make_city
from core.simulation.drive import SimulatedDrive
from core.simulation.raycast import HDL_64E_BEAMS_DEG, SimulatedSensor, cast
from core.simulation.route import Route
from core.simulation.world import Boxes, Cylinders, Scene, Traffic, World

__all__ = [
    "HDL_64E_BEAMS_DEG",
    "Boxes",
    "Cylinders",
    "Route",
    "Scene",
    "SimulatedDrive",
    "SimulatedSensor",
    "Traffic",
    "World",
    "cast",
    "make_city",
]
