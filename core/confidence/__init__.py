"""Calibrated probabilities of matches, and the decision to accept or refuse."""
