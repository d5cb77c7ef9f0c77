"""The client's classes; `make_sync.py` makes the synchronous ones of the asynchronous ones."""
