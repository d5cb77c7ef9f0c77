"""Proposed closures: true in any direction and lane, false elsewhere, else undecided."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.confidence.calibration import Calibration
from core.encodings.signature import Signature
from core.errors import (
    InvalidParameters,
    InvalidScan,
    InvalidSignature,
    StaleSignature,
)
from core.evaluation.condition import Condition
from core.evaluation.disturbances import Recording, parse_disturbances
from core.localization.localizer import Localizer
from core.loop_closure.birds_eye_view import align_views, farthest_m, seen_cells, structure_m
from core.loop_closure.closure import (
    ClosureDecision,
    LoopClosure,
    check_scans,
    check_signatures,
    closure_probability,
)
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.scans.displacement import left_of_m, seen_from_beside
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from core.scans.sensor import sensor_named
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.samples import sample_harmonic_map, sample_image, sample_map

pytestmark = pytest.mark.slow

HEIGHT_M = 1.73
SENSOR = SimulatedSensor()
SHARES = st.floats(0.0, 1.0)


@functools.cache
def drive(*, lateral_offset_m=0.0, reverse=False, sensor=SENSOR):
    """Return a drive through the same streets, with other traffic if it is another pass."""
    other_day = lateral_offset_m != 0.0 or reverse
    return SimulatedDrive(
        seed=401,
        scans=200,
        stops=False,
        lateral_offset_m=lateral_offset_m,
        reverse=reverse,
        traffic_seed=1401 if other_day else None,
        sensor=sensor,
    )


def nearest(other, place_m):
    return int(np.linalg.norm(other.poses[:, :3] - place_m[:3], axis=1).argmin())


@pytest.mark.parametrize("row", [20, 75, 130])
@pytest.mark.parametrize(("offset_m", "reverse"), [(2.0, False), (-3.0, False), (2.0, True)])
def test_a_true_closure_is_found_with_heading_and_offset(row, offset_m, reverse):
    first, second = drive(), drive(lateral_offset_m=offset_m, reverse=reverse)
    at = nearest(second, first.poses[row])
    found = check_scans(first.scan(row), second.scan(at), HEIGHT_M)
    assert found.probability is not None
    assert found.probability > 0.95  # 0.99 accepts: a few true ones are left undecided
    assert found.relative_yaw_deg is not None
    assert found.lateral_m is not None
    expected_deg = 180.0 if reverse else 0.0
    assert abs((found.relative_yaw_deg - expected_deg + 180.0) % 360.0 - 180.0) <= 3.0
    assert found.lateral_m == pytest.approx(left_of_m(first.poses[row], second.poses[at]), abs=0.75)


@pytest.mark.parametrize("row", [20, 75, 130])
@pytest.mark.parametrize("named", ["hdl-32e", "vlp-16"])
def test_a_sparse_tilted_partly_hidden_revisit_in_the_opposite_direction_is_found(row, named):
    recording = Recording(sensor_named(named), HEIGHT_M)
    sensor = SimulatedSensor.of(sensor_named(named))
    first = drive(sensor=sensor)
    second = drive(sensor=sensor, lateral_offset_m=2.0, reverse=True)
    at = nearest(second, first.poses[row])
    rng = np.random.default_rng(row)
    (disturbances,) = parse_disturbances("drop:0.7+hidden:90+pitch:3+roll:2")

    def disturbed(points_m):
        for each in disturbances:
            points_m = each.apply(points_m, recording, rng)
        return Scan(points_m.astype(np.float32))

    seen = disturbed(second.scan(at).points_m.astype(np.float64))
    found = check_scans(first.scan(row), seen, HEIGHT_M)
    assert found.probability is not None
    assert found.probability > 0.8
    assert found.relative_yaw_deg is not None
    assert abs(found.relative_yaw_deg) >= 177.0
    away_m = np.linalg.norm(first.poses[:, :3] - second.poses[at, :3], axis=1)
    for other in np.flatnonzero(away_m > 25.0)[::30]:
        elsewhere = check_scans(first.scan(int(other)), seen, HEIGHT_M)
        assert elsewhere.decide() == ClosureDecision.REJECTED


def test_a_return_at_a_virtual_viewpoint_does_not_reject_its_scan():
    scan, beside = drive().scan(60), [[0.0, 1.5, 0.0]]
    above = scan.points_m[scan.points_m[:, 2] > 0.5 - HEIGHT_M]  # without ground: it stays there
    found = check_scans(Scan(np.concatenate([above, beside])), scan, HEIGHT_M)
    assert found.decide() == ClosureDecision.ACCEPTED


def test_what_only_one_scan_could_see_does_not_count():
    scan = drive().scan(60)
    azimuth_deg = np.degrees(np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0]))
    half = Scan(scan.points_m[np.abs(azimuth_deg) < 90.0])
    assert farthest_m(half)[20:40].max() == 0.0
    assert seen_cells(farthest_m(half))[:70].max() == 0.0
    assert seen_cells(farthest_m(half), relative_yaw_deg=180.0)[90:].max() == 0.0
    found = check_scans(scan, half, HEIGHT_M)
    assert found.relative_yaw_deg == pytest.approx(0.0, abs=1.0)
    assert found.overlap is not None
    assert found.overlap > 0.95
    assert found.image_similarity is not None
    assert found.image_similarity > 0.95


@pytest.mark.parametrize("row", [20, 75, 130])
def test_a_false_closure_is_rejected(row):
    first = drive()
    away_m = np.linalg.norm(first.poses[:, :3] - first.poses[row, :3], axis=1)
    for other in np.flatnonzero(away_m > 25.0)[::30]:
        found = check_scans(first.scan(row), first.scan(int(other)), HEIGHT_M)
        assert found.decide() == ClosureDecision.REJECTED


@pytest.mark.parametrize(("left_m", "relative_yaw_deg"), [(0.0, 0.0), (2.0, 90.0), (-3.0, 180.0)])
def test_the_transform_of_a_moved_scan_is_exact(left_m, relative_yaw_deg):
    scan = drive().scan(60)
    moved = Scan(seen_from_beside(scan.points_m, left_m, relative_yaw_deg).astype(np.float32))
    found = check_scans(scan, moved, HEIGHT_M)
    assert found.relative_yaw_deg is not None
    assert (found.relative_yaw_deg - relative_yaw_deg + 180.0) % 360.0 - 180.0 == pytest.approx(
        0.0, abs=1.0
    )
    assert (found.forward_m, found.lateral_m) == (0.0, left_m)
    assert found.probability is not None
    assert found.probability > 0.99


def test_the_order_of_returns_and_the_sensor_height_change_nothing():
    first, second = drive().scan(60), drive(lateral_offset_m=2.0).scan(60)
    plain = check_scans(first, second, HEIGHT_M)
    shuffled = np.random.default_rng(0).permutation(second.points_m)
    again = check_scans(first, Scan(shuffled), HEIGHT_M)
    assert again.overlap == plain.overlap
    assert again.image_similarity == pytest.approx(plain.image_similarity, abs=1e-6)
    lift_m = np.array([0.0, 0.0, 0.5], np.float32)
    first_higher, second_higher = Scan(first.points_m - lift_m), Scan(second.points_m - lift_m)
    higher = check_scans(first_higher, second_higher, HEIGHT_M + 0.5)
    assert higher.probability == pytest.approx(plain.probability, abs=1e-3)


def test_scans_without_structure_are_rejected_or_do_not_overlap():
    flat = Scan(np.array([[5.0, 0.0, -HEIGHT_M], [0.0, 9.0, -HEIGHT_M]]))
    with pytest.raises(InvalidScan, match="above the ground"):
        check_scans(flat, drive().scan(0), HEIGHT_M)
    kerb = Scan(np.array([[5.0, 0.0, -HEIGHT_M + 0.2]]))
    assert len(structure_m(kerb, HEIGHT_M)) == 0
    found = align_views(kerb, drive().scan(0), np.zeros(1), HEIGHT_M)
    assert found.overlap == 0.0
    far = Scan(np.array([[3e38, 0.0, 0.0], [5.0, 5.0, 0.0]]))
    assert structure_m(far, HEIGHT_M).tolist() == [[5.0, 5.0]]


@given(SHARES, SHARES, SHARES)
def test_more_evidence_is_never_less_probable(one, other, overlap):
    low, high = sorted((one, other))
    assert closure_probability(low, overlap) <= closure_probability(high, overlap)
    assert closure_probability(overlap, low) <= closure_probability(overlap, high)


def test_the_decision_follows_the_threshold():
    likely = LoopClosure(0.97)
    assert likely.decide() == ClosureDecision.UNDECIDED
    assert likely.decide(0.95) == ClosureDecision.ACCEPTED
    assert LoopClosure(0.5).decide() == ClosureDecision.UNDECIDED
    assert LoopClosure(0.49).decide() == ClosureDecision.REJECTED
    assert LoopClosure(None).decide() == ClosureDecision.UNDECIDED
    for wrong in (0.5, 1.01, float("nan")):
        with pytest.raises(InvalidParameters, match="accept_from"):
            likely.decide(wrong)
    with pytest.raises(InvalidParameters, match="probability"):
        LoopClosure(1.5)


CALIBRATION = Calibration(0.001, (-9.0, -3.0, -2.0), (-9.0, -3.5), (-8.0, -3.0))


def test_signatures_are_compared_by_the_maps_calibration():
    tensor_map, _ = sample_harmonic_map()
    localizer = Localizer(replace(tensor_map, calibration=CALIBRATION))
    own = Signature(tensor_map.model.signatures[5, 1], None, tensor_map.basis_digest)
    same = check_signatures(localizer, 5, [own])
    assert same.decide() == ClosureDecision.ACCEPTED
    assert same.relative_yaw_deg == pytest.approx(0.0, abs=1e-6)
    assert same.lateral_m == 0.0
    assert same.signature_distance == pytest.approx(0.0, abs=1e-6)
    assert check_signatures(Localizer(tensor_map), 20, [own]).decide() == ClosureDecision.UNDECIDED
    with pytest.raises(StaleSignature):
        check_signatures(localizer, 5, [Signature(own.values, None, "0" * 64)])
    for row in (-1, len(tensor_map)):
        with pytest.raises(InvalidParameters, match=f"row is {row}"):
            check_signatures(localizer, row, [own])


@functools.cache
def mapped():
    """Return every other scan of the drive, with as many firings as images have columns."""
    few = drive(sensor=SimulatedSensor(firings=360))
    return [few.scan(row) for row in range(0, 200, 2)]


@functools.cache
def localizer():
    """Return the localizer of their map, whose queries are signatures."""
    parameters = MapParameters.for_sensor(verification_images=False)
    return Localizer(build_map(MemoryDrive("monday", mapped()), parameters))


@pytest.mark.parametrize(
    ("disturbance", "ranks"), [("", (3, 3)), ("fov:90", None), ("reach:20", None)]
)
def test_a_wrong_place_is_not_probable_because_signatures_contain_little(disturbance, ranks):
    known, condition = localizer(), Condition(disturb=disturbance)
    places_m = known.map.trajectory.poses[:, :3]
    probable, rows = 0, range(0, len(known.map), 4)
    for row in rows:
        scan = condition.apply(mapped()[row], np.random.default_rng(row))
        signatures = known.basis.encode(known.basis.image(scan), ranks)
        elsewhere = np.linalg.norm(places_m - places_m[row], axis=1) > 25.0
        proposed = int(known.search(signatures).nearest(1, elsewhere).rows[0])
        closure = check_signatures(known, proposed, signatures)
        probable += closure.decide(accept_from=0.9) == ClosureDecision.ACCEPTED
    assert probable <= 0.04 * len(rows)


def test_a_closure_by_a_partial_view_is_less_sure_than_that_distance_of_a_whole_one():
    known = localizer()
    scan = Condition(disturb="fov:180").apply(mapped()[20], np.random.default_rng(0))
    signatures = known.basis.encode(known.basis.image(scan))
    search, calibration = known.search(signatures), known.map.calibration
    found = check_signatures(known, 20, signatures)
    assert found.signature_distance is not None
    assert calibration is not None
    distance = found.signature_distance
    assert found.probability == calibration.probability_of_scan(distance, search.evidence)
    assert found.probability < calibration.probability_of_scan(distance)


def test_a_papers_signature_is_compared_in_its_own_segment_only():
    tensor_map, images = sample_map()
    localizer = Localizer(tensor_map)
    all_of_it = localizer.basis.encode(sample_image(tensor_map, images[12]))
    found = check_signatures(localizer, 12, all_of_it)
    assert found.signature_distance == pytest.approx(0.0, abs=1e-3)
    assert found.relative_yaw_deg is None
    with pytest.raises(InvalidSignature, match="of segment 1, none of the signatures"):
        check_signatures(localizer, 12, [all_of_it[0]])
