"""Errors of commands."""


class CommandFailed(Exception):
    """A command whose service or recording does not allow what it is to do."""
