"""Builds that run beside the service, each in a process of its own."""
