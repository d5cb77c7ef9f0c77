"""Odometry: poses of drives that came without, from their scans (docs/decisions/0040-odometry.md).

`compute_odometry` registers scan after scan, finds and checks loop closures, and adjusts the poses
to both. Only `core.odometry.registration` uses KISS-ICP, which the extra `odometry` installs.
"""
