"""Messages of a track's stream: observations, and problems with the observation that each is of."""

import json
import struct

from fastapi.exceptions import RequestValidationError

from app.http import errors
from app.http.answer_headers import RETRY_AFTER
from app.http.bodies.json_body import read_json
from app.http.field_problems import field_problems
from app.http.problems import problem_response
from app.tracking.schemas import ObservationIn
from core.encodings.signature import unpack_signatures
from core.errors import TensorMapError
from core.numbers import none_if_nan
from core.scans.times import LATEST_S
from core.text import count_of
from core.tracking.track import Observation

OBSERVATION_LAYOUT = 64
"""First byte of packed signatures after their number, time and odometry; no signature's layout."""

_HEADER = struct.Struct("<BQdd")  # layout, sequence, timestamp_s, travelled_m
_MOST_SEQUENCE = 2**53 - 1


def read_observation(body: bytes | str) -> Observation:
    """Read a message: packed signatures, an observation of them, or the JSON of one.

    Raises:
        InvalidSignature: If signatures are malformed.
        InvalidParameters: If a number is infinite.
        InvalidRequest: If the JSON does not fit its schema, or the message is cut off.
    """
    if isinstance(body, str):
        return _from_json(body)
    if body[:1] != bytes([OBSERVATION_LAYOUT]):
        return Observation(unpack_signatures(body))
    if len(body) < _HEADER.size:
        raise errors.InvalidRequest(
            f"the observation has {count_of(len(body), 'byte')}, wanted {_HEADER.size} and its"
            " signatures"
        )
    _, sequence, timestamp_s, travelled_m = _HEADER.unpack_from(body)
    if sequence > _MOST_SEQUENCE:
        raise errors.InvalidRequest(f"sequence is {sequence}, wanted up to {_MOST_SEQUENCE}")
    signatures = unpack_signatures(body[_HEADER.size :])
    return Observation(signatures, none_if_nan(timestamp_s), sequence, none_if_nan(travelled_m))


def problem_message(error: TensorMapError, body: bytes | str, read: Observation | None) -> str:
    """Return the problem that HTTP would answer, with number and time of the observation.

    `retry_after_s` is in it what `Retry-After` is of an answer.

    Args:
        error: Why the message is refused.
        body: The message.
        read: What it holds, if it could be read; of packed signatures the head alone suffices, of
            JSON these two fields.
    """
    response = problem_response(error)
    problem = json.loads(bytes(response.body))
    if (wait_s := response.headers.get(RETRY_AFTER)) is not None:
        problem["retry_after_s"] = int(wait_s)
    if read is not None:
        problem |= {"sequence": read.sequence, "timestamp_s": read.timestamp_s}
    elif isinstance(body, bytes) and _has_head(body):
        _, sequence, timestamp_s, _ = _HEADER.unpack_from(body)
        problem |= _known_of(sequence, timestamp_s)
    elif isinstance(error.__cause__, RequestValidationError):
        found = error.__cause__.body
        if isinstance(found, dict):
            problem |= _known_of(found.get("sequence"), found.get("timestamp_s"))
    return json.dumps(problem)


def _has_head(body: bytes) -> bool:
    return body[:1] == bytes([OBSERVATION_LAYOUT]) and len(body) >= _HEADER.size


def _known_of(sequence: object, timestamp_s: object) -> dict[str, int | float | None]:
    """Return number and time of an observation, each `None` if it cannot be one."""
    if type(sequence) is not int or not 0 <= sequence <= _MOST_SEQUENCE:
        sequence = None
    if not isinstance(timestamp_s, int | float) or not abs(timestamp_s) <= LATEST_S:
        timestamp_s = None
    return {"sequence": sequence, "timestamp_s": timestamp_s}


def _from_json(body: str) -> Observation:
    try:
        return read_json(body.encode(), ObservationIn).to_observation()
    except RequestValidationError as error:
        first = field_problems(error)[0]
        where = first["where"].removeprefix("body").lstrip("/") or "the message"
        raise errors.InvalidRequest(f"{where}: {first['what']}") from error
