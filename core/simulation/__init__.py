"""Simulated worlds and the drives through them."""
