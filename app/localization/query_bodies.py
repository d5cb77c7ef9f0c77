"""Bodies of queries: images, signatures, and batches of these."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from app.http.bodies.bodies import required_type
from app.http.bodies.json_body import read_json
from app.localization.signature_schemas import MOST_QUERIES, BatchIn, SignaturesIn
from core.encodings.signature import Signature, unpack_signatures
from core.errors import InvalidImage, InvalidSignature, StaleSignature, UnknownSegment
from core.projection.imager import Grid, Image
from core.text import count_of
from storage.formats.errors import EmptyBody

IMAGE_TYPE = "application/vnd.tensormap.image"
SIGNATURE_TYPE = "application/vnd.tensormap.signature"
BATCH_TYPE = "application/vnd.tensormap.signatures"
SIGNATURE_TYPES = {SIGNATURE_TYPE: "Packed: docs/reference/signature.md."}
_LENGTH_BYTES = 2  # of each query of a packed batch
_MOST_COUNTED = 100_000  # of these


def read_image(body: bytes, grid: Grid) -> Image:
    """Read an image of a map's grid.

    Raises:
        EmptyBody: If the body is empty.
        InvalidImage: If it has another number of bytes than the grid, or cells that no image has.
    """
    size = 4 * grid.rows * grid.columns
    if not body:
        raise EmptyBody(f"the body is empty, wanted {size} bytes")
    if len(body) != size:
        raise InvalidImage(
            f"the body has {count_of(len(body), 'byte')}, wanted {size}: {grid.rows} x"
            f" {grid.columns} float32"
        )
    return Image(np.frombuffer(body, "<f4").reshape(grid.shape), grid)


def read_signatures(body: bytes, content_type: str | None) -> tuple[Signature, ...]:
    """Read one scan's signatures, packed or as JSON.

    Raises:
        EmptyBody: If the body is empty.
        UnsupportedBody: If they are of another type.
        InvalidSignature: If they are packed wrongly.
        RequestValidationError: If the JSON does not fit its schema.
    """
    if not body:
        raise EmptyBody("the body is empty, wanted signatures")
    if required_type(content_type, "application/json", SIGNATURE_TYPE) == SIGNATURE_TYPE:
        return unpack_signatures(body)
    return read_json(body, SignaturesIn).to_core()


def read_batch(body: bytes, content_type: str | None) -> list[tuple[Signature, ...]]:
    """Read the signatures of several scans, packed or as JSON.

    Raises:
        EmptyBody: If there is none.
        UnsupportedBody: If they are of another type.
        InvalidSignature: If they are packed wrongly, or are too many.
        RequestValidationError: If the JSON does not fit its schema.
    """
    if not body:
        raise EmptyBody("the body is empty, wanted signatures")
    if required_type(content_type, "application/json", BATCH_TYPE) != BATCH_TYPE:
        return [
            _to_core(number, query) for number, query in enumerate(read_json(body, BatchIn).queries)
        ]
    queries: list[tuple[Signature, ...]] = []
    start = 0
    while start < len(body):
        if len(body) - start < _LENGTH_BYTES:
            raise InvalidSignature(
                f"the body ends after {count_of(len(body) - start, 'byte')} of the length of query"
                f" {len(queries)}, wanted {_LENGTH_BYTES}"
            )
        length = int.from_bytes(body[start : start + _LENGTH_BYTES], "little")
        start += _LENGTH_BYTES
        if start + length > len(body):
            raise InvalidSignature(
                f"query {len(queries)} has {count_of(length, 'byte')}, the body ends"
                f" after {len(body) - start} of them"
            )
        if len(queries) == MOST_QUERIES:
            raise InvalidSignature(
                f"the batch has {_counted(body)} queries, wanted at most {MOST_QUERIES}"
            )
        with of_query(len(queries)):
            queries.append(unpack_signatures(body[start : start + length]))
        start += length
    return queries


def _counted(body: bytes) -> str:
    """Return how many queries a packed batch has; far too many are not counted to their end."""
    count = start = 0
    while start < len(body) and count < _MOST_COUNTED:
        start += _LENGTH_BYTES + int.from_bytes(body[start : start + _LENGTH_BYTES], "little")
        count += 1
    return f"more than {count}" if start < len(body) else str(count)


@contextmanager
def of_query(number: int) -> Iterator[None]:
    """Name a query of a batch, counted from 0, in the errors that it causes."""
    try:
        yield
    except (InvalidSignature, StaleSignature, UnknownSegment) as error:
        raise type(error)(f"query {number}: {error}") from error


def _to_core(number: int, query: SignaturesIn) -> tuple[Signature, ...]:
    with of_query(number):
        return query.to_core()
