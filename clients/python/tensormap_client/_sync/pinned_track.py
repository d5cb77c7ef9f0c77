# Made by make_sync.py: change _async instead.
"""A track of the service, in one revision of a map."""

import contextlib
import json
import math
import struct
import time
from collections.abc import Callable

from numpy.typing import ArrayLike

from tensormap_client._sync.bases import Bases
from tensormap_client._sync.transport import Transport
from tensormap_client.answers import JsonObject, TrackAnswer
from tensormap_client.errors import ClientError, Unreachable
from tensormap_client.io_sync import Stream
from tensormap_client.odometer import Odometer
from tensormap_client.problems import StaleObservation
from tensormap_client.rejections import rejection
from tensormap_client.signature.basis import Basis, Tilt

_OBSERVATION = struct.Struct("<BQdd")  # 64, sequence, time, odometry
_LAYOUT = 64
_LAST_SEQUENCE = "TensorMap-Last-Sequence"
_NO_WAIT_S = 0.0  # an observation that comes late is worth nothing


class Sent:
    """A scan that is sent, encoded once for each basis, its parameters and its `least_cells`.

    Args:
        sequence: Its number.
        timestamp_s: Its time, if known.
        points: Its returns.
        tilt: The vehicle's tilt, if known.
        encode: Makes its signatures.
        odometer: The vehicle's odometer.
    """

    def __init__(
        self,
        sequence: int,
        timestamp_s: float | None,
        points: ArrayLike,
        tilt: Tilt | None,
        encode: Callable[[ArrayLike, Basis, Tilt | None], bytes],
        odometer: Odometer,
    ) -> None:
        self.sequence = sequence
        self._timestamp_s, self._points, self._tilt = timestamp_s, points, tilt
        self._encode, self._odometer = encode, odometer
        self._signatures: dict[tuple[str, str, int], bytes] = {}

    def message(self, basis: Basis, since: int | None) -> bytes:
        """Return the message of this scan (docs/reference/http-api.md, "Streams").

        Args:
            basis: The basis to sign the scan with.
            since: The last observation that the service has.

        Raises:
            UnusableScan: If the scan has no signature.
        """
        kind = basis.digest, json.dumps(dict(basis.parameters)), basis.least_cells
        if kind not in self._signatures:
            self._signatures[kind] = self._encode(self._points, basis, self._tilt)
        known = (self._timestamp_s, self._odometer.since(since))
        numbers = (math.nan if number is None else number for number in known)
        return _OBSERVATION.pack(_LAYOUT, self.sequence, *numbers) + self._signatures[kind]


class PinnedTrack:
    """A track of the service.

    Args:
        transport: The connections to the service.
        path: The track's path.
        revision: The track's revision.
        basis: The revision's basis.
        timeout_s: How long to wait for an answer, in seconds.
    """

    def __init__(
        self,
        transport: Transport,
        path: str,
        revision: str,
        basis: Basis,
        timeout_s: float,
    ) -> None:
        self.revision = revision
        self._transport, self._path, self._basis = transport, path, basis
        self._timeout_s = timeout_s
        self._stream: Stream | None = None
        self._key_changes = 0  # of the transport, when the stream was opened
        self._last: int | None = None  # sequence that the service has
        self._late: int | None = None  # that it may still be at work on, and until when
        self._late_until_s = 0.0
        self._begun = False

    @classmethod
    def create(
        cls, transport: Transport, bases: Bases, map_path: str, timeout_s: float
    ) -> "PinnedTrack":
        """Create a track in the live revision.

        Raises:
            UnsupportedMap: If this version cannot make signatures for the map.
            ClientError: If the service cannot be reached or rejects the track.
        """
        tracks = f"{map_path}/tracks"
        created = transport.json("POST", tracks, patience_s=_NO_WAIT_S)
        path, revision = f"{tracks}/{created['track']}", created["revision"]
        try:
            basis = bases.get(revision, _NO_WAIT_S)
        except BaseException:  # also of a caller that stops waiting
            _remove(transport, path)
            raise
        return cls(transport, path, revision, basis, timeout_s)

    def observe(self, sent: Sent) -> TrackAnswer:
        """Return the answer to a scan.

        Raises:
            ClientClosed: If its client was closed, or is that of another process.
            Unreachable: If the service does not answer.
            Rejected: If it rejects the scan, or does not have this track any more.
        """
        self._transport.require_open()
        if self._key_changes != self._transport.key_changes:
            self._disconnect()
        if self._stream is not None:
            try:
                return self._exchanged(sent, self._stream)
            except Unreachable as error:
                if isinstance(error.__cause__, TimeoutError):
                    raise
        # It was closed, perhaps a while ago: it is opened again at once, and once.
        self._key_changes = self._transport.key_changes  # first: another key may come meanwhile
        self._stream = self._transport.stream(f"{self._path}/stream")
        last_sequence = self._stream.headers.get(_LAST_SEQUENCE)
        # An earlier service sends none: get it.
        if last_sequence is None or last_sequence == str(sent.sequence):
            last = self._last_answer()
            if last is not None and last.sequence == sent.sequence:
                return last  # the service took it, and only the answer was lost
        else:
            self._last = int(last_sequence) if last_sequence.isdecimal() else None
        try:
            return self._exchanged(sent, self._stream)
        except StaleObservation:
            last = self._last_answer()
            if last is None or last.sequence != sent.sequence:
                raise
            return last  # the service was still at work on it before

    def remove(self) -> None:
        """Remove the track from the service, if that can be reached."""
        self._disconnect()
        _remove(self._transport, self._path)

    def _exchanged(self, sent: Sent, stream: Stream) -> TrackAnswer:
        message = sent.message(self._basis, self._since(sent.sequence))
        self._begun = True
        try:
            said = stream.exchange(message, self._timeout_s)
            answer = JsonObject.of_message(self._path, said)
            if answer.get("sequence", sent.sequence) != sent.sequence:
                raise Unreachable(
                    f"observation {answer['sequence']} was answered, {sent.sequence} was sent"
                )
        except BaseException:  # also of a caller that stops waiting
            # The service may still be at work on it, even if the connection was lost.
            self._late = sent.sequence
            self._late_until_s = time.monotonic() + self._timeout_s
            self._disconnect()
            raise
        if "observations" not in answer:
            wait_s = answer.get("retry_after_s", 0)  # a message has no headers
            raise rejection(
                f"stream {self._path}",
                answer["status"],
                json.dumps(answer),
                {"Retry-After": str(wait_s)},
            )
        self._last, self._late = sent.sequence, None
        return TrackAnswer.from_json(answer)

    def _since(self, sequence: int) -> int | None:
        """Return the observation from which the odometry of another one counts.

        `None` if the service may take a late one before it: the odometry would count twice.
        """
        is_late = self._late is not None and time.monotonic() < self._late_until_s
        return None if is_late and self._late not in {self._last, sequence} else self._last

    def _last_answer(self) -> TrackAnswer | None:
        """Return the service's last answer, `None` if it has received no observation."""
        if not self._begun:
            return None
        try:
            known = (self._transport.json("GET", self._path, patience_s=_NO_WAIT_S))["last"]
        except BaseException:  # the next scan gets it: its odometry counts from there
            self._disconnect()
            raise
        last = None if known is None else TrackAnswer.from_json(known)
        self._last = None if last is None else last.sequence
        return last

    def _disconnect(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None


def _remove(transport: Transport, path: str) -> None:
    with contextlib.suppress(ClientError):
        transport.request("DELETE", path, patience_s=_NO_WAIT_S)
