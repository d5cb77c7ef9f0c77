"""Builds: planned, queued, and run in processes of their own."""
