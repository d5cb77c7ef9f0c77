"""Why a demonstration could not go on; no error of the service, which answers by problems."""

__all__ = ["DemoFailed"]


class DemoFailed(Exception):
    """The service did not start, refused a request or could not build."""
