"""Peers that are packages of their own, compared with where they are installed."""
