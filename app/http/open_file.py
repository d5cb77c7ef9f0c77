"""A download that survives the deletion of its file."""

import os
from typing import Any, BinaryIO

from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send


class OpenFileResponse(FileResponse):
    """The content of an open file; supports ranges, as its base does.

    The base opens its path after the status was sent, when it is too late to report that the file
    was deleted. This one uses the path of the open file under /proc, which works for deleted files.
    """

    def __init__(self, file: BinaryIO, **options: Any) -> None:  # noqa: ANN401 - those of the base
        self._file = file
        descriptor = file.fileno()
        super().__init__(f"/proc/self/fd/{descriptor}", stat_result=os.fstat(descriptor), **options)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file and close it."""
        with self._file:
            await super().__call__(scope, receive, send)
