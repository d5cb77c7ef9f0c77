"""A TensorMap: the immutable content of one map revision (paper, fig. 2d)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import FloatArray, IntArray, freeze
from core.confidence.calibration import Calibration
from core.confidence.rescaling import Rescaling
from core.encodings.basis import Basis
from core.encodings.model import Model
from core.encodings.search import Search
from core.errors import EmptyDrive, InvalidMap, InvalidParameters
from core.mapping.components import drives_aside
from core.mapping.limited_queries import LimitedScans, LimitedSignatures
from core.mapping.placement import Placement, placements_from_attributes
from core.parameters import MapParameters
from core.revision import content_digest
from core.scans.trajectory import Trajectory
from core.single_flight import SingleFlight, single_flight_property
from core.topology import JOINED, Topology, segment_ends

_WHOLE = {
    "segment_start",
    "drive_start",
    "scan_index",
    "node_scan",
    "edge_nodes",
    "edge_scans",
    "edge_of_segment",
    "segment_reversed",
    "hidden_sectors",
    "signature_codes",
    "verification_images",
}

_LIMITS_KEPT = 256  # a few numbers each; there are four of scans, and more of signatures


@dataclass(frozen=True, eq=False)
class TensorMap:
    """Segments' models, where their scans were recorded, and the graph they form.

    Attributes:
        parameters: The choices it was built with.
        model: Bases and signatures, in the encoding of the parameters.
        trajectory: Drive, time and pose of each scan.
        topology: Nodes, edges, and the edge along which each segment runs.
        relative_error: `(L,)` |X - X^| / |X| of each segment's images, renderings included.
        calibration: The calibration of distances to probabilities; `None` if the map is not
            calibrated.
        image_calibration: The calibration of queries that verification images are compared with;
            `None` without them too.
        placements: The placements of drives whose poses in the trajectory are not those given, by
            name.
        computed_poses: The drives whose poses were computed from their scans, each in a frame of
            its own, in the map's order. Files of earlier releases do not name them.
    """

    parameters: MapParameters
    model: Model
    trajectory: Trajectory
    topology: Topology
    relative_error: FloatArray
    calibration: Calibration | None = None
    image_calibration: Calibration | None = None
    placements: Mapping[str, Placement] = field(default_factory=dict)
    computed_poses: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, relative_error=np.float64)
        scans, segments = len(self.model), self.model.segments
        if len(self.trajectory) != scans:
            raise InvalidMap(f"{scans} signatures and {len(self.trajectory)} scans")
        if self.relative_error.shape != (segments,):
            raise InvalidMap(f"{segments} segments and {self.relative_error.shape} errors")
        if not ((self.relative_error >= 0) & (self.relative_error <= 1)).all():
            raise InvalidMap("relative_error has numbers that are not within 0..1")
        if len(self.topology.edge_of_segment) != segments:
            raise InvalidMap(
                f"{segments} segments and {len(self.topology.edge_of_segment)} in the graph"
            )
        if len(self.topology.node_scan) and not (
            self.topology.node_scan.min() >= 0 and self.topology.node_scan.max() < scans
        ):
            raise InvalidMap("node_scan names a scan that does not exist")
        drives, computed = self.trajectory.drives, set(self.computed_poses)
        if unknown := computed.difference(drives):
            raise InvalidMap(f"computed_poses holds {min(unknown)!a:.80}, which is no drive")
        in_order = tuple(name for name in drives if name in computed)
        object.__setattr__(self, "computed_poses", in_order)
        starts = self.model.segment_start
        if not np.isin(self.trajectory.drive_start, starts).all():
            raise InvalidMap("a segment runs from one drive into the next")
        self._require_nodes()
        self.parameters.encoder.require_model(self.model, self.parameters)

    def _require_nodes(self) -> None:
        nodes = self.topology.node_scan[self.topology.segment_nodes]
        starts = self.model.segment_start
        if self.topology.is_plain:
            if (nodes[:, 0] > starts[:-1]).any() or (nodes[:, 1] < starts[1:] - 1).any():
                raise InvalidMap("a segment's scans are not between its edge's nodes")
        elif (nodes > self.segment_ends).any() or not np.isin(
            self.topology.node_scan, self.segment_ends
        ).all():
            raise InvalidMap("a node is not at the first segment end at its place")

    def __len__(self) -> int:
        return len(self.trajectory)

    def __repr__(self) -> str:  # the fields' arrays would be hundreds of lines
        encoding, ranks = self.parameters.encoding, self.parameters.ranks
        return (
            f"TensorMap(scans={len(self)}, drives={len(self.trajectory.drives)},"
            f" segments={self.model.segments}, {encoding=}, {ranks=}, revision={self.revision!r})"
        )

    @cached_property
    def revision(self) -> str:
        """The digest of the content, 64 hexadecimal digits."""
        return content_digest(self.arrays(), self.attributes())

    @cached_property
    def drives_aside(self) -> frozenset[str]:
        """The drives that lie beside the others, and so not in the frame of the map."""
        return drives_aside(self.posed_drives, self.placements)

    @cached_property
    def posed_drives(self) -> tuple[str, ...]:
        """The drives that have a pose, in the map's order."""
        posed = {*self.trajectory.drive_of_scan[self.trajectory.known].tolist()}
        return tuple(name for drive, name in enumerate(self.trajectory.drives) if drive in posed)

    @cached_property
    def segment_ends(self) -> IntArray:
        """Rows of the scans at which each segment begins and ends, `(L, 2)`."""
        return segment_ends(self.trajectory.drive_start, self.model.segment_start)

    @cached_property
    def basis_digests(self) -> tuple[str, ...]:
        """The digests of the bases that this map answers, 64 hexadecimal digits each.

        One of a harmonic map; in the paper's encoding of its first 1, 2, ... L segments.
        """
        return self.model.basis_digests(self.parameters)

    @property
    def basis_digest(self) -> str:
        """The digest of the basis of all segments."""
        return self.basis_digests[-1]

    @property
    def least_cells(self) -> int:
        """A query whose image has fewer occupied cells is refused; 0 without calibration."""
        return 0 if self.calibration is None else self.calibration.least_cells

    @property
    def calibration_of_scans(self) -> Calibration | None:
        """The calibration of queries by scan or image, `None` if they have none.

        Where the map has verification images, with which they are compared, it is not that of
        signatures: of a small map either may be missing.
        """
        return self.image_calibration if self.verification_bytes else self.calibration

    def calibration_of(self, search: Search) -> Calibration | None:
        """Return the calibration of a search's distances; `None` if the map is not calibrated.

        If the query has or sees less than the map's own, its distances are rescaled, or its odds
        lowered where images are compared too.
        """
        calibration = self.image_calibration if search.verified else self.calibration
        if calibration is None or search.limits is None:
            return calibration
        if search.verified:
            return calibration.lowered(self._odds_gained(search.limits))
        return calibration.rescaled(self.rescalings(search.limits))

    def rescaling_of(self, search: Search) -> Rescaling | None:
        """Return how a signature's distances become those that calibrated the map.

        `None` if they are these already.
        """
        return None if search.limits is None else self.rescalings(search.limits)

    @single_flight_property
    def rescalings(self) -> SingleFlight[Rescaling]:
        """The rescaling by `Search.limits`, measured on scans of the map when it is first called.

        That takes as long as some hundred queries.
        """
        measured = LimitedSignatures(self.model, self.trajectory, self.revision)
        return SingleFlight(measured.rescaling, _LIMITS_KEPT)

    @single_flight_property
    def _odds_gained(self) -> SingleFlight[float]:
        """How much higher the log-odds of wrong matches are within limits, of scans."""
        calibration = self.image_calibration
        assert calibration is not None  # noqa: S101 - for mypy
        measured = LimitedScans(self.model, self.trajectory, calibration)
        return SingleFlight(measured.odds_gained, _LIMITS_KEPT)

    @property
    def verification_bytes(self) -> int:
        """The size of its verification images, which `elements` does not count."""
        images = self.model.arrays().get("verification_images")
        return 0 if images is None else images.nbytes

    @property
    def elements(self) -> int:
        """How many numbers the bases and signatures are (paper, sec. 2.4)."""
        return self.parameters.encoder.elements(self.parameters, self.model.segments, len(self))

    def basis(self, segments: Sequence[int] | IntArray | None = None) -> Basis:
        """Return the basis with which a vehicle encodes scans, for all or some segments.

        A harmonic map has one basis for all of them.

        Raises:
            UnknownSegment: If the map has no such segment.
        """
        chosen = np.arange(self.model.segments)
        if segments is not None:
            chosen = np.unique(np.asarray(segments, dtype=np.int64))
            self.model.require_segments(chosen)
        return self.model.basis(self.revision, self.basis_digest, self.parameters, chosen)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return every array of the map by its name in the file."""
        return {
            **self.model.arrays(),
            "relative_error": self.relative_error,
            "drive_start": self.trajectory.drive_start,
            "scan_index": self.trajectory.scan_index,
            "timestamp_s": self.trajectory.timestamp_s,
            "pose": self.trajectory.poses,
            **self.topology.arrays(),
        }

    def attributes(self) -> dict[str, Any]:
        """Return every attribute of the map, as plain values."""
        attributes = {**self.parameters.as_attributes(), "drives": list(self.trajectory.drives)}
        if self.calibration is not None:
            attributes["calibration"] = self.calibration.as_attributes()
        if self.image_calibration is not None:
            attributes["image_calibration"] = self.image_calibration.as_attributes()
        if self.placements:
            attributes["placements"] = {
                name: placement.as_attributes() for name, placement in self.placements.items()
            }
        if self.computed_poses:
            attributes["computed_poses"] = list(self.computed_poses)
        return attributes

    @classmethod
    def from_parts(
        cls,
        arrays: Mapping[str, NDArray[Any]],
        attributes: Mapping[str, Any],
        revision: str | None = None,
    ) -> "TensorMap":
        """Return the map of these arrays and attributes.

        Args:
            arrays: The arrays by name.
            attributes: The attributes by name.
            revision: The digest of both, if it was checked before; otherwise it is computed when
                needed.

        Raises:
            InvalidMap: If something is missing or invalid.
        """
        try:
            parameters = MapParameters.from_attributes(dict(attributes))
            coded = "signature_codes" in arrays
            dtypes = parameters.encoder.arrays_of(attributes, coded=coded)
            a = {name: _numbers(name, arrays[name], dtypes.get(name, "")) for name in arrays}
            tensor_map = cls(
                parameters,
                parameters.encoder.read_model(parameters, a),
                Trajectory(
                    tuple(attributes["drives"]),
                    a["drive_start"],
                    a["scan_index"],
                    a["timestamp_s"],
                    a["pose"],
                ),
                _topology(a),
                a["relative_error"],
                _calibration(attributes, "calibration"),
                _calibration(attributes, "image_calibration"),
                placements_from_attributes(attributes),
                tuple(attributes.get("computed_poses", ())),
            )
        except KeyError as error:
            raise InvalidMap(f"the map lacks {error}") from error
        except (
            AttributeError,
            EmptyDrive,
            IndexError,
            InvalidParameters,
            OverflowError,
            RecursionError,
            TypeError,
            ValueError,
        ) as error:
            raise InvalidMap(f"the map's parts are invalid: {error}") from error
        if tensor_map.attributes() != dict(attributes):
            raise InvalidMap("the map has attributes that are unknown or not normalized")
        if revision is not None:
            tensor_map.__dict__["revision"] = revision  # where `cached_property` stores it
        return tensor_map


def _numbers(name: str, array: NDArray[Any], dtype: str) -> NDArray[Any]:
    """Return an array of numbers of its kind: none is rounded, cut off or read from text."""
    kinds = "iu" if name in _WHOLE else "cfiu" if "c" in dtype else "fiu"
    values = np.asarray(array)
    if values.dtype.kind not in kinds:
        raise InvalidMap(f"{name} has dtype {values.dtype}, wanted numbers of another kind")
    return values


def _calibration(attributes: Mapping[str, Any], name: str) -> Calibration | None:
    if name not in attributes:  # an older file, or one of dropped returns
        return None
    return Calibration.from_attributes(attributes[name])


def _topology(a: dict[str, NDArray[Any]]) -> Topology:
    joined = {name: a[name] for name in JOINED if name in a}
    if joined and not np.isin(joined["segment_reversed"], (0, 1)).all():
        raise InvalidMap("segment_reversed has other numbers than 0 and 1")
    return Topology(a["node_scan"], a["edge_nodes"], a["edge_length_m"], **joined)
