"""The demonstration: a mapping vehicle, a build and a fleet vehicle against a real service."""
