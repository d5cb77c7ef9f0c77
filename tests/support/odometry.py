"""Tests of computed poses, on a Python for which there is a library that computes them."""

import sys

import pytest

from core.odometry.registration import library_version

CAN_COMPUTE = sys.version_info < (3, 14) or library_version() is not None
needs_odometry = pytest.mark.skipif(
    not CAN_COMPUTE, reason="KISS-ICP has no release for this Python"
)
