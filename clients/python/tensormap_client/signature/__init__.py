"""Signatures made on a vehicle, with NumPy only.

Written a second time on purpose, from docs/reference/signature.md: the service's code does the
same, and tests compare the bytes.
"""
