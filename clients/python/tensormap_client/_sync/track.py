# Made by make_sync.py: change _async instead.
"""Tracking of a vehicle over one WebSocket, which is opened again when it breaks."""

import time
from collections.abc import Callable

from numpy.typing import ArrayLike

from tensormap_client._sync.bases import Bases
from tensormap_client._sync.closable import Closable
from tensormap_client._sync.pinned_track import PinnedTrack, Sent
from tensormap_client._sync.track_maker import TrackMaker
from tensormap_client._sync.transport import Transport
from tensormap_client.answers import TrackAnswer
from tensormap_client.checks import require_number
from tensormap_client.errors import ClientClosed, ClientError, Rejected, Unreachable
from tensormap_client.odometer import FARTHEST_M, Odometer
from tensormap_client.problems import RevisionNotFound, TrackNotFound
from tensormap_client.signature.basis import Basis, Tilt
from tensormap_client.waits import LONGEST_ASKED_S, Waits

_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.1, 1.0
_HAND_OVER_WAIT_S = 5.0  # before a hand-over that failed is tried again
_LATEST_S = 1e11  # the service rejects more
_GONE = (TrackNotFound, RevisionNotFound)

Encode = Callable[[ArrayLike, Basis, Tilt | None], bytes]


class Track(Closable):
    """A track of a vehicle, for about 10 scans a second, and one thread or task at a time.

    It uses the revision that is live at first. When another one becomes live, scans go to a
    second track there too, and that one takes over as soon as it is localized. Scans are lost while
    the service is unreachable; their odometry is added to that of the next scan, unless the service
    may still be at work on one: for `timeout_s` after it was sent.

    Attributes:
        failure: Why `observe` returned `None`; `None` from the next answer on.
    """

    def __init__(
        self,
        transport: Transport,
        bases: Bases,
        map_path: str,
        encode: Encode,
        timeout_s: float,
    ) -> None:
        self.failure: ClientError | None = None
        self._encode = encode
        self._maker = TrackMaker(transport, bases, map_path, timeout_s)
        self._pinned: PinnedTrack | None = None
        self._next: PinnedTrack | None = None
        self._odometer = Odometer()
        self._sequence = 0
        self._waits, self._not_before_s = Waits(_FIRST_WAIT_S, _LONGEST_WAIT_S), 0.0
        self._hand_over_not_before_s = 0.0
        self._is_closed = False

    def close(self) -> None:
        """Remove the track from the service, if it can be reached; `observe` is an error then.

        It waits for a track that is being made for a caller that stopped waiting, and removes it.
        """
        self._is_closed = True
        _remove(self._pinned)
        _remove(self._next)
        self._pinned = self._next = None
        self._maker.discard()

    def observe(
        self,
        points: ArrayLike,
        *,
        timestamp_s: float | None = None,
        travelled_m: float | None = None,
        tilt: Tilt | None = None,
    ) -> TrackAnswer | None:
        """Return where the vehicle is, or `None` if the service does not answer: see `failure`.

        It waits at most `timeout_s` of the vehicle for each request: one message, and a few more
        to begin, to open a stream that broke, and when another revision becomes live. After a
        failure it sends nothing for up to a second, or for as long as the service asks by
        `Retry-After`, at most half a minute; nor if the answer to its beginning was lost, because
        the service then has a track that nobody knows.

        Args:
            points: The scan, as for `Vehicle.locate`.
            timestamp_s: The scan's time in seconds by the vehicle's own clock, within 1e11 of 0;
                later scans have later times.
            travelled_m: Distance travelled since the last call in metres, negative backwards,
                within 1e6 of 0.
            tilt: The vehicle's tilt, if it is measured against gravity.

        Raises:
            InvalidArgument: If the time, the distance or the tilt is none, or out of its range.
            ClientClosed: If `close` was called, of the track or of its vehicle.
            UnusableScan: If the scan has too few returns, or nothing of it is in the map's image.
            TooFewCells: If too little of it is. Such a scan is not sent, and its odometry counts
                with that of the next one.
            UnsupportedMap: If this version cannot make signatures for the map.
            Rejected: If the service rejects the scan for good; the subclass gives the reason.
        """
        if self._is_closed:
            raise ClientClosed("the track is closed: make another one")
        if timestamp_s is not None:
            require_number("timestamp_s", timestamp_s, _LATEST_S)
        if travelled_m is not None:
            require_number("travelled_m", travelled_m, FARTHEST_M)
        self._sequence += 1
        self._odometer.add(self._sequence, travelled_m)
        if time.monotonic() < self._not_before_s:
            return None
        sent = Sent(self._sequence, timestamp_s, points, tilt, self._encode, self._odometer)
        try:
            answer = self._observed(sent)
        except (Unreachable, Rejected) as error:
            if isinstance(error, Rejected) and not error.is_passing:
                raise
            self.failure = error
            asked_s = error.retry_after_s if isinstance(error, Rejected) else 0.0
            wait_s = self._waits.next_s(min(asked_s, LONGEST_ASKED_S))
            self._not_before_s = time.monotonic() + wait_s
            return None
        if answer is None:
            self.failure = self._maker.failure
            return None
        self.failure = None
        self._waits.begin_again()
        return answer

    def _observed(self, sent: Sent) -> TrackAnswer | None:
        """Return the answer to a scan, `None` if it is too early to make another track for it."""
        while True:
            pinned = self._pinned
            if pinned is None and self._maker.must_wait:
                return None
            is_new = pinned is None and not self._maker.is_begun
            if pinned is None:
                pinned = self._pinned = self._maker.made()
            try:
                answer = pinned.observe(sent)
                break
            except _GONE:  # the vehicle was away for too long
                if is_new:
                    raise
                self._pinned, self._next = self._next, None
        if answer.live_revision in {None, answer.revision}:
            if answer.live_revision is not None:  # another one may have been live for a while
                successor, self._next = self._next, None
                _remove(successor)
            return answer
        try:
            return self._handed_over(sent, pinned, answer)
        except ClientError as error:
            if isinstance(error, _GONE):
                self._next = None
            self._hand_over_not_before_s = time.monotonic() + _HAND_OVER_WAIT_S
            return answer

    def _handed_over(self, sent: Sent, pinned: PinnedTrack, answer: TrackAnswer) -> TrackAnswer:
        """Return the answer of the live revision once it knows the place, else this one."""
        if time.monotonic() < self._hand_over_not_before_s:
            return answer
        successor = self._next
        if successor is not None and successor.revision != answer.live_revision:
            self._next = None
            _remove(successor)
            successor = None
        if successor is None:
            if self._maker.must_wait:
                return answer
            successor = self._next = self._maker.made()
        found = successor.observe(sent)
        if answer.localized and not found.localized:
            return answer
        self._pinned, self._next = successor, None
        _remove(pinned)
        return found


def _remove(pinned: PinnedTrack | None) -> None:
    if pinned is not None:
        pinned.remove()
