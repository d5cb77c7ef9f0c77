"""Simulated worlds and the drives through them."""

from core.simulation.city import make_city
from core.simulation.world import Boxes, Cylinders, Scene, Traffic, World

__all__ = ["Boxes", "Cylinders", "Scene", "Traffic", "World", "make_city"]
