"""Several drives in one map: maps merged, drives left out, and how well a kept basis fits."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray
from core.encodings.grams import fit_radial_basis, radial_error
from core.encodings.harmonic import HarmonicModel
from core.encodings.paper import PaperModel
from core.errors import BasisMismatch, EmptyDrive, InvalidParameters, UnknownDrive
from core.mapping.tensormap import TensorMap
from core.scans.trajectory import Trajectory
from core.topology import join_segments

__all__ = ["BasisFit", "basis_fits", "merge_maps", "without_drives"]

_MUCH_WORSE = 1.02
"""Of the error that a refitted basis leaves: docs/decisions/0014-merging-and-basis-identity.md."""


@dataclass(frozen=True)
class BasisFit:
    """How well a radial basis that was kept fits one drive.

    Attributes:
        drive: Its name.
        kept_error: `radial_error` over the renderings of its scans, U kept.
        refitted_error: The same with U fitted anew to all drives that are at hand.
    """

    drive: str
    kept_error: float
    refitted_error: float

    @property
    def much_worse(self) -> bool:
        """Whether refitting would be worth asking vehicles to download their basis again."""
        return self.kept_error > _MUCH_WORSE * self.refitted_error

    def __str__(self) -> str:
        return (
            f"the basis that was kept leaves out {self.kept_error:.3f} of the detail of drive"
            f" {self.drive}, one fitted anew would leave out {self.refitted_error:.3f}"
        )


def basis_fits(radial_basis: Float32Array, grams: Mapping[str, FloatArray]) -> tuple[BasisFit, ...]:
    """Compare a basis that was kept with the one that all these drives would give, by drive.

    Args:
        radial_basis: `(I, r1)`, the U that was kept.
        grams: What `core.encodings.grams.drive_gram` gave for each drive, by name.
    """
    refitted = fit_radial_basis(grams, radial_basis.shape[1])
    return tuple(
        BasisFit(name, radial_error(gram, radial_basis), radial_error(gram, refitted))
        for name, gram in grams.items()
    )


def merge_maps(maps: Sequence[TensorMap]) -> TensorMap:
    """Put the drives of several maps into one, exactly: no number of any of them changes.

    Harmonic maps must share one radial basis, that is, all but the first were built with the first
    one's: the result then is what a build of all drives with that basis gives. The paper's
    segments have bases of their own and are put one after another: the result is what a build of
    all drives gives. A vehicle's basis of the first map stays good either way.

    Args:
        maps: At least one, of the same parameters, no drive in two of them.

    Raises:
        InvalidParameters: If there is none, their parameters differ, or a drive is in two.
        BasisMismatch: If harmonic ones differ in their radial basis.
    """
    if not maps:
        raise InvalidParameters("there is no map to merge")
    first = maps[0]
    for other in maps[1:]:
        _require_alike(first, other)
    names = [name for part in maps for name in part.trajectory.drives]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidParameters(
            f"drive {twice[0]!r} is in several of the maps: leave it out of one"
        )
    if len(maps) == 1:
        return first
    model = _merged_model([part.model for part in maps])
    trajectory = Trajectory.concatenate([part.trajectory for part in maps])
    return TensorMap(
        first.parameters,
        model,
        trajectory,
        join_segments(trajectory, model.segment_start),
        np.concatenate([part.relative_error for part in maps]),
    )


def without_drives(tensor_map: TensorMap, names: Collection[str]) -> TensorMap:
    """Return the map without some of its drives; all that is kept stays as it is.

    Raises:
        UnknownDrive: If it has no such drive.
        EmptyDrive: If none would be left.
    """
    drives = tensor_map.trajectory.drives
    unknown = sorted(set(names) - set(drives))
    if unknown:
        raise UnknownDrive(f"the map has no drive {unknown[0]!r}, it has {', '.join(drives)}")
    kept = [position for position, name in enumerate(drives) if name not in names]
    if not kept:
        raise EmptyDrive("no drive would be left in the map")
    if len(kept) == len(drives):
        return tensor_map
    rows = np.flatnonzero(np.isin(tensor_map.trajectory.drive_of_scan, kept))
    segments = np.flatnonzero(np.isin(tensor_map.model.segment_start[:-1], rows))
    lengths = np.diff(tensor_map.model.segment_start)[segments]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    model = tensor_map.model
    if isinstance(model, HarmonicModel):
        of_kept: PaperModel | HarmonicModel = HarmonicModel(
            model.radial_basis,
            model.signatures[rows],
            model.lateral_offset_m,
            starts,
            model.columns,
            model.measure,
        )
    else:
        of_kept = PaperModel(
            model.elevation_basis[segments],
            model.azimuth_basis[segments],
            model.signatures[rows],
            starts,
        )
    trajectory = tensor_map.trajectory.select(rows)
    return TensorMap(
        tensor_map.parameters,
        of_kept,
        trajectory,
        join_segments(trajectory, of_kept.segment_start),
        tensor_map.relative_error[segments],
    )


def _require_alike(first: TensorMap, other: TensorMap) -> None:
    one, two = first.parameters.as_attributes(), other.parameters.as_attributes()
    if one != two:
        name = next(name for name in {**one, **two} if one.get(name) != two.get(name))
        raise InvalidParameters(
            f"{name} is {two.get(name)} in the map of {', '.join(other.trajectory.drives)},"
            f" {one.get(name)} in that of {', '.join(first.trajectory.drives)}"
        )
    if isinstance(first.model, HarmonicModel) and first.basis_digest != other.basis_digest:
        raise BasisMismatch(
            f"the map of {', '.join(other.trajectory.drives)} has basis {other.basis_digest[:16]},"
            f" that of {', '.join(first.trajectory.drives)} has {first.basis_digest[:16]}: build it"
            " with the first one's basis, or one map of all drives"
        )


def _merged_model(
    models: Sequence[PaperModel | HarmonicModel],
) -> PaperModel | HarmonicModel:
    first = models[0]
    offsets = np.cumsum([0, *(len(model) for model in models)])
    starts = np.concatenate(
        [m.segment_start[:-1] + offset for m, offset in zip(models, offsets, strict=False)]
        + [offsets[-1:]]
    )
    signatures = np.concatenate([model.signatures for model in models])
    if isinstance(first, HarmonicModel):
        return HarmonicModel(
            first.radial_basis,
            signatures,
            first.lateral_offset_m,
            starts,
            first.columns,
            first.measure,
        )
    of_paper = [model for model in models if isinstance(model, PaperModel)]
    return PaperModel(
        np.concatenate([model.elevation_basis for model in of_paper]),
        np.concatenate([model.azimuth_basis for model in of_paper]),
        signatures,
        starts,
    )
