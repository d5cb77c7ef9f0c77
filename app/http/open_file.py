"""A download that survives the deletion of its file."""

import os
from typing import Any, BinaryIO

from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send


class OpenFileResponse(FileResponse):
    """The content of a file that is open already; takes ranges, as its base does.

    The base opens its path only once the status is sent, when it is too late to say that the file
    is gone. This one is given the path under which Linux keeps an open file, deleted or not.
    """

    def __init__(self, file: BinaryIO, **options: Any) -> None:  # noqa: ANN401 - those of the base
        self._file = file
        descriptor = file.fileno()
        super().__init__(f"/proc/self/fd/{descriptor}", stat_result=os.fstat(descriptor), **options)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file and close it."""
        with self._file:
            await super().__call__(scope, receive, send)
