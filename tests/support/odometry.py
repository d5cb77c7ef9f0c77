"""Tests of computed poses, on a Python for which there is a library that computes them."""

import pytest

from app.builds.odometry import HAS_LIBRARY
from core.odometry.registration import library_version

CAN_COMPUTE = HAS_LIBRARY or library_version() is not None
NO_LIBRARY = "KISS-ICP has no release for this Python"
needs_odometry = pytest.mark.skipif(not CAN_COMPUTE, reason=NO_LIBRARY)
