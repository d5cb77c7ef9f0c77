"""Why a demonstration could not go on; no error of the service, which answers by problems."""


class DemoFailed(Exception):
    """The service did not start, refused a request or could not build."""
