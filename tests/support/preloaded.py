"""What the process that forks jobs has imported in tests: what jobs need, and what reads bags.

Each of dozens of captures would import that itself, which takes 0.15 s.
"""

import rosbags.highlevel
import rosbags.typesys.stores.ros2_humble  # noqa: F401

import app.jobs.preloaded  # noqa: F401
import storage.formats.drives.ros2_reader  # noqa: F401
