# Made by make_sync.py: change _async instead.
"""The client's classes; `make_sync.py` makes the synchronous ones of the asynchronous ones."""
