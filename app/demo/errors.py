"""The error of a demonstration."""


class DemoFailed(Exception):
    """The service did not start, ended, refused a request or could not build."""
