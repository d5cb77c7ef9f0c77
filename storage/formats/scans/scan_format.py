"""What a reader of one scan format implements."""

from abc import ABC, abstractmethod
from typing import ClassVar

from core.arrays import Float32Array


class ScanFormat(ABC):
    """One format of scan files.

    Attributes:
        name: The format's common name.
        media_type: The Content-Type of its files, lower case.
        suffixes: How the names of its files end, lower case, with the dot.
        magics: How its files begin; none if they may begin with any bytes.
    """

    name: ClassVar[str]
    media_type: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()
    magics: ClassVar[tuple[bytes, ...]] = ()

    @abstractmethod
    def read(self, body: bytes) -> Float32Array:
        """Return all returns, `(n, 3)` metres, including those that are not finite or zero.

        Raises:
            InvalidScan: If the bytes are no such file; a subclass says why.
        """
