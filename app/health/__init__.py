"""Health: whether the service works, its release, and its metrics."""
