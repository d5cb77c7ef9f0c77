"""Drives merged, left out and added: exact, with the basis that vehicles hold."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.encodings.grams import (
    detail_gram,
    drive_gram,
    fit_radial_basis,
    radial_error,
    sum_of_grams,
)
from core.encodings.harmonic.basis import HarmonicBasis
from core.errors import (
    BasisMismatch,
    EmptyDrive,
    InvalidMap,
    InvalidParameters,
    StaleSignature,
    UnknownDrive,
    UnknownSegment,
)
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.mapping.merge import merge_maps, without_drives
from core.projection.imager import Image
from core.projection.images import ConcatenatedImages, MemoryImages
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from tests.support.samples import (
    RecordedProgress,
    random_images,
    sample_harmonic_map,
    sample_image,
    sample_map,
)

HARMONIC = sample_harmonic_map(8)[0].parameters
PAPER = sample_map(8)[0].parameters


class Part:
    """A drive with its images, of one encoding."""

    def __init__(self, name, count, seed, parameters=HARMONIC):
        self.parameters, self.name = parameters, name
        grid, renderings = parameters.grid, parameters.lateral_renderings_m
        shape = (count, *(() if renderings is None else (len(renderings),)), *grid.shape)
        cells = random_images(int(np.prod(shape[:-2])), grid.shape, seed).reshape(shape)
        self.images = MemoryImages(cells, grid)
        self.trajectory = Trajectory.of_drive(
            name, np.full(count, np.nan), np.full((count, 7), np.nan), np.arange(count)
        )

    def gram(self):
        return drive_gram(self.images, 0, np.ones(len(self.images), bool))


def built(parts, **options):
    trajectory = Trajectory.concatenate([part.trajectory for part in parts])
    return fit_map(
        ConcatenatedImages([part.images for part in parts]),
        trajectory,
        cut_drives(trajectory.drive_start, 10),
        parts[0].parameters,
        **options,
    )


def of(u):
    r1 = u.shape[1]
    return HarmonicBasis.of(replace(HARMONIC, ranks=(r1, HARMONIC.ranks[1])), u)


def parts_of(*counts, parameters=HARMONIC):
    names = ("a", "b", "c", "d")
    return [Part(names[i], n, i, parameters) for i, n in enumerate(counts)]


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 70), min_size=1, max_size=4), st.randoms(use_true_random=False))
def test_a_build_of_all_drives_is_the_merge_of_its_parts_to_the_bit(counts, random):
    """Whatever the order in which workers are done with their drives' sums."""
    parts = parts_of(*counts)
    whole = built(parts)
    done = list(parts)
    random.shuffle(done)
    grams = {part.name: part.gram() for part in done}
    u = fit_radial_basis(grams, whole.parameters.ranks[0])
    assert u.tobytes() == whole.model.radial_basis.tobytes()
    assert built(parts, grams=grams).revision == whole.revision
    merged = merge_maps([built([part], kept=of(u)) for part in parts])
    assert merged.revision == whole.revision


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=4))
def test_a_build_of_all_drives_is_the_merge_of_its_parts_in_the_papers_encoding(counts):
    parts = parts_of(*counts, parameters=PAPER)
    assert merge_maps([built([part]) for part in parts]).revision == built(parts).revision


def test_the_basis_does_not_depend_on_the_order_of_drives():
    parts = parts_of(20, 30, 7)
    digests = {built(order).basis_digest for order in itertools.permutations(parts)}
    assert len(digests) == 1


def test_the_sum_over_all_drives_is_that_of_their_images():
    parts = parts_of(40, 33)
    total = sum_of_grams({part.name: part.gram() for part in parts})
    cells = np.concatenate([part.images.read(0, 100) for part in parts])
    np.testing.assert_allclose(total, detail_gram(cells.reshape(-1, *HARMONIC.grid.shape)))


def test_merging_is_associative_and_leaves_no_number_changed():
    first, *others = parts_of(12, 20, 5)
    one = built([first])
    more = [built([part], kept=one.basis()) for part in others]
    left = merge_maps([merge_maps([one, more[0]]), more[1]])
    right = merge_maps([one, merge_maps(more)])
    assert left.revision == right.revision
    assert left.model.signatures[:12].tobytes() == one.model.signatures.tobytes()
    assert merge_maps([one]) is one


@pytest.mark.parametrize("parameters", [HARMONIC, PAPER], ids=["harmonic", "paper"])
def test_leaving_a_drive_out_is_the_build_without_it(parameters):
    parts = parts_of(12, 25, 7, parameters=parameters)
    whole = built(parts)
    kept = {} if parameters is PAPER else {"kept": whole.basis()}
    for left_out in parts:
        rest = [part for part in parts if part is not left_out]
        assert without_drives(whole, [left_out.name]).revision == built(rest, **kept).revision
    assert without_drives(whole, []) is whole


def test_drives_that_cannot_be_left_out_or_merged_are_rejected():
    one, two = built(parts_of(12)), built([Part("b", 12, 5)])
    with pytest.raises(UnknownDrive, match="no drive 'z', it has a"):
        without_drives(one, ["z"])
    with pytest.raises(EmptyDrive, match="no drive would be left"):
        without_drives(one, ["a"])
    with pytest.raises(BasisMismatch, match="build it with the first one's basis"):
        merge_maps([one, two])
    with pytest.raises(InvalidParameters, match="drive 'a' is in several"):
        merge_maps([one, one])
    with pytest.raises(InvalidParameters, match="encoding is paper in the map of b, harmonic"):
        merge_maps([one, built([Part("b", 12, 5, PAPER)])])
    with pytest.raises(InvalidParameters, match="no map"):
        merge_maps([])


def test_a_kept_basis_takes_one_pass_and_a_wrong_one_is_rejected():
    [part] = parts_of(40)
    u = built([part]).model.radial_basis
    progress = RecordedProgress()
    built([part], progress=progress, kept=of(u))
    assert (progress.stages, progress.done) == ([("fitting", 40)], [40])
    with pytest.raises(InvalidParameters, match="cannot be kept"):
        built([part], kept=of(u[:, :2]))
    with pytest.raises(InvalidParameters, match=r"sums are of drives \['z'\]"):
        built([part], grams={"z": part.gram()})
    with pytest.raises(InvalidParameters, match="the sum of drive a is"):
        built([part], grams={"a": part.gram()[1:, 1:]})
    with pytest.raises(InvalidParameters, match="cannot be kept"):
        built(parts_of(12, parameters=PAPER), kept=of(u))
    with pytest.raises(InvalidMap, match="is repeated"):
        built([part, part])


def test_a_signature_of_the_held_basis_is_answered_after_a_drive_was_added():
    first, second = parts_of(12, 20)
    before = built([first])
    held = before.basis()  # what the vehicle downloaded
    after = built([first, second], kept=before.basis())
    assert after.revision != before.revision
    for part, row in ((first, 3), (second, 12 + 5)):
        cells = part.images.read(0, 100)[row - (0 if part is first else 12), 1]
        image = Image(cells, held.parameters.grid)
        found = Localizer(after).localize_signatures(held.encode(image))
        assert (found.best.row, found.revision) == (row, after.revision)
        assert found.best.distance == pytest.approx(0.0, abs=1e-4)  # of rounding to 8 bits
    refitted = built([first, second])
    with pytest.raises(StaleSignature, match=refitted.basis_digest):
        Localizer(refitted).localize_signatures(held.encode(image))


def test_the_papers_first_segments_stay_answerable_after_a_drive_was_added():
    first, second = parts_of(20, 20, parameters=PAPER)
    before, after = built([first]), built([first, second])
    held = before.basis()
    image = sample_image(after, first.images.read(4, 5)[0])
    localizer = Localizer(after)
    found = localizer.localize_signatures(held.encode(image))
    assert (found.segments, found.best.row) == ((0, 1), 4)
    named_too_far = [
        type(s)(s.values, s.segment, held.digest) for s in after.basis([2]).encode(image)
    ]
    with pytest.raises(UnknownSegment, match=r"segments 0\.\.1, the signature of 2"):
        localizer.localize_signatures(named_too_far)
    assert not localizer.answers(built([second]).basis_digest)  # a continuation, not any overlap
    assert not localizer.answers(held.digest[:15])


def test_a_basis_is_named_by_what_signatures_depend_on_and_by_nothing_else():
    [part] = parts_of(30)
    plain = built([part])
    u = plain.model.radial_basis
    assert built([Part("other", 9, 4)], kept=of(u)).basis_digest == plain.basis_digest
    flipped = u.copy()
    flipped[0, 0] = np.nextafter(u[0, 0], np.float32(9))
    assert built([part], kept=of(flipped)).basis_digest != plain.basis_digest
    held = plain.basis()
    with pytest.raises(InvalidMap, match="its content is"):
        type(held)(held.revision, held.digest, held.parameters, flipped)


def test_a_kept_basis_reports_its_fit_to_other_drives():
    grid = HARMONIC.grid
    low, high = np.zeros((2, 9, 3, *grid.shape), np.float32)
    low[..., :3, :], high[..., 3:, :] = 1.0, 1.0
    grams = {
        name: drive_gram(MemoryImages(cells, grid), 0, np.ones(9, bool))
        for name, cells in (("low", low), ("high", high))
    }
    u = fit_radial_basis({"low": grams["low"]}, 1)
    of_low, of_high = of(u).fits(grams)
    assert of_low.drive == "low"
    assert of_low.kept_error == pytest.approx(0.0, abs=1e-3)
    assert of_high.kept_error == pytest.approx(1.0)
    assert radial_error(grams["high"], u) == of_high.kept_error
    assert not of_low.much_worse
    assert "leaves out 1.000 of the detail of drive high" in str(of_high)


def test_drives_with_computed_poses_are_known_in_what_is_merged_and_left():
    tensor_map, _ = sample_map(drives=2)
    odometry = replace(tensor_map, computed_poses=("drive-1",))
    parts = [without_drives(odometry, {name}) for name in ("drive-1", "drive-0")]
    assert [part.computed_poses for part in parts] == [(), ("drive-1",)]
    assert merge_maps(parts).computed_poses == ("drive-1",)
