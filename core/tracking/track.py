"""Tracks: the observations of one vehicle in one revision of a map."""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import FloatArray, IntArray
from core.confidence.places import AWAY_M
from core.encodings.search import Neighbours, Search
from core.encodings.signature import Signature
from core.errors import InvalidParameters, StaleObservation
from core.localization.localizer import Localizer
from core.localization.match import Match, match_at
from core.numbers import require_at_least
from core.projection.imager import Image
from core.scans.pose import Pose
from core.scans.times import flaw_of_time
from core.tracking.belief import Belief
from core.tracking.contradiction import contradicts
from core.tracking.emission import Emission
from core.tracking.graph import TravelGraph
from core.tracking.intervals import Intervals
from core.tracking.motion import Motion
from core.tracking.path_position import with_estimate
from core.tracking.place import Place
from core.tracking.prediction import LONGEST_SHARE, predicted
from core.tracking.state import TrackState, likeliest
from core.tracking.stationary import StationaryDetector, StationaryModel
from core.tracking.step import SURE, Doubt, TrackStep

MOST_TRAVELLED_M = 1e6
"""Between two observations: farther than a vehicle drives while a track waits for it."""

_FIRST_FIX = 3  # certain observations in a row: two may have the same error
_ELSEWHERE = 0.5  # probability of being outside of the map, for `unknown_place`
_SIGMA_OF_ROW = 12.0**-0.5  # scans: of a place anywhere half-way to the next scans
_MOVE_ODDS = 0.9  # belief beyond a stationary vehicle's last position from which it is moved


@dataclass(frozen=True, eq=False)
class Observation:
    """What a vehicle sends at one time.

    Attributes:
        signatures: The signatures of one scan.
        timestamp_s: Its time by the vehicle's own clock, within `LATEST_S` of 0; rises if given.
        sequence: Its number; rises if given. Without times, numbers left out are taken as time.
        travelled_m: Odometry since the last observation, negative backwards; at most
            `MOST_TRAVELLED_M` either way.
        image: The image of the same scan, if there is one: in a map with verification images the
            vehicle's pose is where they are most alike.

    Raises:
        InvalidParameters: If a number is out of its range.
    """

    signatures: tuple[Signature, ...]
    timestamp_s: float | None = None
    sequence: int | None = None
    travelled_m: float | None = None
    image: Image | None = None

    def __post_init__(self) -> None:
        require_at_least(0, sequence=self.sequence)
        flaw = None if self.timestamp_s is None else flaw_of_time(self.timestamp_s)
        if flaw is not None:
            raise InvalidParameters(f"timestamp_s is {flaw}")
        if self.travelled_m is not None and not abs(self.travelled_m) <= MOST_TRAVELLED_M:
            raise InvalidParameters(
                f"travelled_m is {self.travelled_m}, wanted metres since the last observation,"
                f" within {MOST_TRAVELLED_M:g} of 0"
            )


class Tracker:
    """The models of one revision, shared by its tracks; safe to share between threads.

    Args:
        localizer: The revision's localizer.
        cut_position: The positions of its segments' cuts, see `TravelGraph.of_map`.
    """

    def __init__(self, localizer: Localizer, cut_position: FloatArray | None = None) -> None:
        self.localizer = localizer
        self.map = localizer.map
        self.motion = Motion()
        self.motion.prepare()
        self.graph = TravelGraph.of_map(self.map, cut_position)
        self.graph.prepare()
        self.emission = Emission.of_map(self.map)
        self.stationary = StationaryModel.of_map(self.map)
        self.row_variance_m2 = (
            _row_lengths_m(self.map.trajectory.stands, self.graph.along_m) ** 2 / 12
        )
        self.of_detection = {
            stationary: self.stationary.likelihood(self.motion.pace, stationary=stationary)
            for stationary in (False, True)
        }


class _Order:
    """Times and numbers of observations.

    Args:
        state: The state of an earlier track that this one continues.
    """

    def __init__(self, state: TrackState | None = None) -> None:
        self.times_s, self.numbers = Intervals(), Intervals()
        if state is not None:
            self.times_s = Intervals(state.timestamp_s, list(state.periods_s))
            self.numbers = Intervals(state.sequence)

    def require_newer(self, observation: Observation) -> None:
        for name, last in (
            ("timestamp_s", self.times_s.last),
            ("sequence", self.numbers.last),
        ):
            given = getattr(observation, name)
            if last is not None and given is not None and given <= last:
                raise StaleObservation(
                    f"the observation's {name} is {given}, the track's last one had {last}"
                )

    def gap_s(self, observation: Observation) -> float:
        """Return the time since the last one, infinite if it is not known."""
        return self.times_s.since(observation.timestamp_s)

    def share(self, observation: Observation) -> float:
        """Return the time since the last one as a share of the usual, 1 if nothing is known.

        Without times it is that of their numbers: an observation that did not come is counted.
        """
        share = self.times_s.share(observation.timestamp_s)
        if share is None:
            share = self.numbers.share(observation.sequence)
        return 1.0 if share is None else share

    def keep(self, observation: Observation, *, continues: bool) -> None:
        """Keep an observation's time and number, and the intervals since the last ones.

        Args:
            observation: The new one.
            continues: Whether the last ones are of the earlier track that this one continues: the
                time between two tracks is not the usual one, and is not kept.
        """
        self.times_s.keep(observation.timestamp_s, continues=continues)
        self.numbers.keep(observation.sequence, continues=continues)


class Track:
    """One vehicle in one revision of a map; not for several threads at once.

    A Bayes filter over the scans of the map, the direction of travel and the pace. An observation
    that is refused changes nothing. After ten times the usual time between two observations a place
    is accepted when three of them agree again.

    Args:
        tracker: The revision's tracker.
        state: The state of an earlier track of the same revision that this one continues. Its place
            is accepted when three observations agree again.
        gap_s: Seconds from that track's last observation to the first of this one.

    Attributes:
        last: The last answer.
        gap_s: As above. It may be set until that observation, and does not count where timestamps
            say it.

    Raises:
        InvalidParameters: If the state is of another map.
    """

    def __init__(
        self, tracker: Tracker, state: TrackState | None = None, gap_s: float = 0.0
    ) -> None:
        self._tracker = tracker
        self._order = _Order()
        self._belief = Belief.unknown(tracker.graph, tracker.motion)
        self._observations = 0
        self._continued: TrackState | None = None  # until an observation is taken
        self.gap_s = gap_s
        if state is not None and state.observations:
            self._order = _Order(state)
            self._belief = state.belief(tracker.graph, tracker.motion, 0.0)
            self._observations = state.observations
            self._continued = state
        self._taken = 0  # without those of the earlier track
        self._detector = StationaryDetector(tracker.stationary, resumed=self._observations > 0)
        self._agreeing = 0  # certain observations in a row
        self._position: float | None = None  # of the last answer
        self.last: TrackStep | None = None

    @property
    def revision(self) -> str:
        """The revision of the track, which never changes."""
        return self._tracker.map.revision

    @property
    def localizer(self) -> Localizer:
        """The localizer of that revision."""
        return self._tracker.localizer

    @property
    def observations(self) -> int:
        """How many it has had."""
        return self._observations

    @property
    def sequence(self) -> int | None:
        """Number of the last observation, `None` without one."""
        last = self._order.numbers.last
        return None if last is None else int(last)

    @property
    def belief(self) -> Belief:
        """The belief after the last observation."""
        return self._belief

    @property
    def continues(self) -> bool:
        """Whether it continues an earlier track and has not observed yet: `gap_s` counts then."""
        return self._continued is not None

    @property
    def state(self) -> TrackState:
        """What a later track needs to continue this one.

        Until its first observation it is the state that this one continues.
        """
        if self._continued is not None:
            return self._continued
        return TrackState(
            observations=self._observations,
            places=likeliest(self._belief) if self._observations else (),
            elsewhere=self._belief.elsewhere,
            timestamp_s=self._order.times_s.last,
            sequence=self.sequence,
            periods_s=tuple(self._order.times_s.usual),
        )

    def observe(self, observation: Observation) -> TrackStep:
        """Take the next observation.

        Raises:
            StaleObservation: If its timestamp or sequence number is not above the last one's.
            StaleSignature: If a signature was made with another revision's bases.
            UnknownSegment: If the map has no such segment.
            InvalidSignature: If the signatures are not of this map or not of one scan.
            SensorMismatch: If the image is of another kind or grid.
        """
        self._order.require_newer(observation)
        localizer, image = self._tracker.localizer, observation.image
        search = localizer.search(observation.signatures)
        seen = search if image is None else localizer.search_image(image)
        belief, has_gap = self._predicted(observation)
        stationary = self._detector.update(observation.signatures)
        rescaling = self._tracker.map.rescaling_of(search)
        likelihood = self._tracker.emission.of_search(
            search, belief.of_scan, rescaling, self._detector.independence
        )
        belief = belief.updated(likelihood, self._tracker.of_detection[stationary])
        self._order.keep(observation, continues=self.continues)
        if has_gap:
            self._agreeing = 0
        self._observations += 1
        self._taken += 1
        self._belief = belief
        self._continued = None
        self.last = self._step(observation, search, seen, likelihood, stationary=stationary)
        return self.last

    def _predicted(self, observation: Observation) -> tuple[Belief, bool]:
        """Return the belief before an observation, and whether there was a gap before it.

        Where nothing is known of the way the vehicle is where a restarted service has it.
        """
        if not self._observations:
            return self._belief, False
        graph, motion, order = self._tracker.graph, self._tracker.motion, self._order
        # The pace of a continued track is not known: before its first observation is a gap.
        share = math.inf if self.continues else order.share(observation)
        found = predicted(self._belief, graph, motion, share, observation.travelled_m)
        if found is None:
            gap_s = order.gap_s(observation)
            if self.continues and not math.isfinite(gap_s):
                gap_s = self.gap_s
            return self.state.belief(graph, motion, gap_s), True
        return found, share > LONGEST_SHARE

    def _step(
        self,
        observation: Observation,
        search: Search,
        seen: Search,
        likelihood: FloatArray,
        *,
        stationary: bool,
    ) -> TrackStep:
        """Return the answer to an observation that the belief has, and count it."""
        tracker = self._tracker
        place = Place.most_likely(self._belief, tracker.map, tracker.graph)
        held = self._held(place) if stationary else None
        position = place.position if held is None else held
        row = min(max(math.floor(position + 0.5), place.rows.start), place.rows.stop - 1)
        segment = tracker.graph.segment_at(position)
        last = int(tracker.map.trajectory.stands[row, 1])
        if last > row and tracker.map.model.segment_of_scan[row] != segment:
            # All of a stand is in its last segment: so are the scan and the fraction.
            row, position = last, float(last)
        among = np.zeros(len(tracker.map), bool)
        among[row] = True
        # A query of the paper's encoding may have no signature of this scan's segment.
        found = search.nearest(1, among)
        if not len(found):
            found = Neighbours.of_distances(np.array([row]), np.array([np.inf]))
        match = match_at(tracker.map, search, found, seen=seen if seen.verified else None)
        if held is None:
            of_row_m2 = float(tracker.row_variance_m2[row])
            position = with_estimate(position, match, tracker.map.trajectory, of_row_m2)
            # A segment's cut may be elsewhere than half-way between two scans.
            segment = tracker.graph.segment_at(position)
        self._position = position
        sure = place.probability >= SURE
        agrees = sure and not contradicts(tracker.map, search, likelihood, row)
        self._agreeing = self._agreeing + 1 if agrees else 0
        reason = self._doubt()
        return TrackStep(
            revision=self.revision,
            observations=self._observations,
            localized=reason is None,
            reason=reason,
            segment=segment,
            fraction=tracker.graph.fraction_at(segment, position),
            segment_probability=place.share_between(
                *tracker.graph.cut_position[segment : segment + 2].tolist()
            ),
            position=position,
            match=match,
            probability=place.probability,
            direction=place.direction,
            stationary=stationary,
            along_sigma_m=place.sigma_m(tracker.graph.along_m, tracker.row_variance_m2),
            along_sigma_scans=math.hypot(place.sigma, _SIGMA_OF_ROW),
            pose=_pose(tracker.map.trajectory.poses, position, match),
            timestamp_s=observation.timestamp_s,
            sequence=observation.sequence,
        )

    def _held(self, place: Place) -> float | None:
        """Return a stationary vehicle's last position; `None` if most of the belief is beyond it.

        So it is before the first position, too.
        """
        last = self._position
        if last is None or not place.rows.start <= last <= place.rows.stop - 1:
            return None
        before, after = place.beyond(math.floor(last + 0.5))
        return None if max(before, after) > _MOVE_ODDS else last

    def _doubt(self) -> Doubt | None:
        """Return why the place is not certain, `None` if it is."""
        if self._agreeing >= _FIRST_FIX:
            return None
        if self._agreeing or self._taken < _FIRST_FIX:
            return Doubt.CONVERGING
        return Doubt.UNKNOWN_PLACE if self._belief.elsewhere > _ELSEWHERE else Doubt.AMBIGUOUS


def _row_lengths_m(stands: IntArray, along_m: FloatArray) -> FloatArray:
    """Return how long the path is that each row means, `(K,)`: half-way to its neighbours.

    Of a stand it is all of its rows'. What is `AWAY_M` from a scan is another place.
    """
    halves_m = np.minimum(np.nan_to_num(np.diff(along_m)) / 2.0, AWAY_M)
    before_m, after_m = np.append(0.0, halves_m), np.append(halves_m, 0.0)
    first, last = stands.T
    return np.asarray(along_m[last] - along_m[first] + before_m[first] + after_m[last])


def _pose(poses: FloatArray, position: float, match: Match) -> Pose | None:
    """Return the estimated pose, or that at a position between rows where none is estimated."""
    if match.estimated_pose is not None:
        return match.estimated_pose
    low = min(max(math.floor(position), 0), match.row)
    high = min(low + 1, len(poses) - 1)
    pair = poses[[low, high]]
    if not np.isfinite(pair).all():
        return match.pose
    share = min(max(position - low, 0.0), 1.0)
    from scipy.spatial.transform import Rotation, Slerp  # most answers have an estimate

    rotation = Slerp([0.0, 1.0], Rotation.from_quat(pair[:, 3:]))(share)
    between = np.concatenate(
        [(1.0 - share) * pair[0, :3] + share * pair[1, :3], rotation.as_quat(canonical=True)]
    )
    return Pose.from_row(between)
