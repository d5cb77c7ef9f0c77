"""No deadline for hypothesis' examples: the machine is shared, and none of them is timed."""

from hypothesis import settings

settings.register_profile("shared-machine", deadline=None)
settings.load_profile("shared-machine")
