"""Localization: the closest core tensor slice over all segments (paper, sec. 2.3)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.confidence.places import AWAY_M, AWAY_SCANS
from core.encodings.signature import Signature, pack_signatures, unpack_signatures
from core.errors import (
    InvalidMap,
    InvalidParameters,
    InvalidSignature,
    SensorMismatch,
    StaleSignature,
    UnknownSegment,
)
from core.localization.localizer import Localizer
from core.localization.match import match_at
from core.mapping.fit import fit_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Image
from core.projection.images import MemoryImages, project_drive
from core.scans.sensor import AngularGrid
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_fixed
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.topology import Topology
from tests.support.samples import random_images, sample_drive, sample_image, sample_map


@pytest.fixture(scope="module")
def made():
    return sample_map(count=24, segment_length=8, drives=2)


@pytest.fixture(scope="module")
def localizer(made):
    return Localizer(made[0])


def signatures_of(localizer, ranges_m):
    return localizer.basis.encode(sample_image(localizer.map, ranges_m))


def test_every_map_image_finds_itself(made, localizer):
    tensor_map, images = made
    for row, ranges_m in enumerate(images):
        best = localizer.localize_image(sample_image(tensor_map, ranges_m)).best
        assert best.row == row
        assert best.distance < 1e-3
        assert (best.drive, best.scan_index) == (f"drive-{row // 24}", row % 24)
        assert best.segment == row // 8
        first = 8 * best.segment
        last = first + 7 if best.segment in {2, 5} else first + 8
        assert best.fraction == pytest.approx((row - first) / (last - first))
        assert best.along_m == pytest.approx(row - first)
        assert best.pose is not None
        assert best.pose.as_tuple() == tuple(tensor_map.trajectory.poses[row])
        assert best.timestamp_s == tensor_map.trajectory.timestamp_s[row]


def test_a_scan_its_image_and_its_signatures_get_one_answer():
    drive = sample_drive(20)
    parameters = MapParameters(grid=AngularGrid(-30.0, 10.0, 6, 20.0), ranks=(3, 3))
    projected = project_drive(drive, np.arange(20), parameters.imager)
    trajectory = Trajectory.of_drive("d", drive.timestamp_s, drive.poses, np.arange(20))
    localizer = Localizer(fit_map(projected.images, trajectory, cut_fixed(20, 5), parameters))
    for row in range(20):
        image = localizer.basis.image(drive.scan(row))
        by_scan = localizer.localize_scan(drive.scan(row), k=3)
        assert by_scan == localizer.localize_image(image, k=3)
        assert by_scan == localizer.localize_signatures(localizer.basis.encode(image), k=3)
        assert by_scan.best.row == row


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), k=st.integers(1, 60))
def test_the_answer_is_that_of_a_loop_over_all_slices(made, localizer, seed, k):
    tensor_map, _ = made
    ranges_m = random_images(1, tensor_map.parameters.grid.shape, seed + 1)[0]
    found = localizer.localize_image(sample_image(tensor_map, ranges_m), k)
    model = tensor_map.model
    expected = []
    for row, segment in enumerate(model.segment_of_scan):
        u, v = model.elevation_basis[segment], model.azimuth_basis[segment]
        signature = u.T @ ranges_m.astype(np.float64) @ v
        expected.append((float(np.linalg.norm(signature - model.signatures[row])), row))
    expected.sort()
    assert [match.row for match in found.matches] == [row for _, row in expected[:k]]
    np.testing.assert_allclose(
        [match.distance for match in found.matches], [d for d, _ in expected[:k]], rtol=1e-5
    )


def test_k_beyond_the_map_returns_every_scan_once(made, localizer):
    tensor_map, images = made
    found = localizer.localize_image(sample_image(tensor_map, images[3]), k=10**30)
    assert sorted(match.row for match in found.matches) == list(range(48))
    distances = [match.distance for match in found.matches]
    assert distances == sorted(distances)


@pytest.mark.parametrize("k", [0, -1])
def test_k_below_one_is_rejected(made, localizer, k):
    with pytest.raises(InvalidParameters, match=f"k is {k}"):
        localizer.localize_image(sample_image(made[0], made[1][0]), k)


@pytest.mark.parametrize("segments", [[4], [1, 3], [5, 0, 2]])
def test_exactly_the_segments_of_the_signatures_are_searched(made, localizer, segments):
    _, images = made
    all_of_them = signatures_of(localizer, images[20])
    found = localizer.localize_signatures([all_of_them[i] for i in segments], k=1000)
    assert found.segments == tuple(sorted(segments))
    assert {match.segment for match in found.matches} == set(segments)
    assert len(found.matches) == 8 * len(segments)
    whole = {
        match.row: match.distance
        for match in localizer.localize_signatures(all_of_them, k=1000).matches
    }
    assert {match.row: match.distance for match in found.matches} == pytest.approx(
        {row: distance for row, distance in whole.items() if row // 8 in segments}
    )


def test_part_of_the_basis_makes_the_same_signatures(made, localizer):
    tensor_map, images = made
    part = tensor_map.basis(np.array([4, 1]))
    assert set(part.segments.tolist()) == {1, 4}
    image = sample_image(tensor_map, images[0])
    whole = localizer.basis.encode(image)
    for signature in part.encode(image):
        np.testing.assert_allclose(
            signature.values, whole[signature.segment].values, rtol=1e-5, atol=1e-4
        )
        assert signature.revision == tensor_map.basis_digest
    with pytest.raises(UnknownSegment, match=r"no segment 6; the map has 0\.\.5"):
        tensor_map.basis(np.array([6]))


def changed(signature, **changes):
    parts = {
        "values": signature.values,
        "segment": signature.segment,
        "revision": signature.revision,
    }
    return Signature(**{**parts, **changes})


@pytest.mark.parametrize("revision", ["", "f" * 64, "{own:.15}", "{own}0", "{own:.63}g", "{other}"])
def test_a_signature_of_another_revision_is_rejected_and_names_this_one(made, localizer, revision):
    other, _ = sample_map(seed=9)
    text = revision.format(own=made[0].revision, other=other.revision)
    signature = changed(signatures_of(localizer, made[1][0])[0], revision=text)
    with pytest.raises(StaleSignature, match=made[0].revision):
        localizer.localize_signatures([signature])


@pytest.mark.parametrize("digits", [16, 40, 64])
def test_the_first_digits_of_a_revision_name_it(made, localizer, digits):
    signature = changed(signatures_of(localizer, made[1][0])[0], revision=made[0].revision[:digits])
    assert localizer.localize_signatures([signature]).revision == made[0].revision


def test_signatures_that_cannot_be_answered_are_rejected(made, localizer):
    first, second, *_ = signatures_of(localizer, made[1][0])
    with pytest.raises(InvalidSignature, match="at least one signature"):
        localizer.localize_signatures([])
    with pytest.raises(InvalidSignature, match=r"shape \(4, 3\), this map's have \(3, 4\)"):
        localizer.localize_signatures([first, changed(second, values=second.values.T)])
    with pytest.raises(InvalidSignature, match="is repeated"):
        localizer.localize_signatures([first, changed(second, segment=0)])
    with pytest.raises(UnknownSegment, match=r"no segment 6; the map has 0\.\.5"):
        localizer.localize_signatures([changed(first, segment=6)])


def test_an_image_on_another_grid_is_rejected(localizer):
    image = Image(np.ones((30, 361), np.float32), AngularGrid())
    with pytest.raises(SensorMismatch, match="the image is on"):
        localizer.localize_image(image)


def test_an_image_of_the_same_shape_but_other_angles_is_rejected(made, localizer):
    grid = AngularGrid(-20.0, 10.0, 6, 20.0)
    assert grid.shape == made[0].parameters.grid.shape
    with pytest.raises(SensorMismatch):
        localizer.localize_image(Image(made[1][0], grid))


@pytest.mark.parametrize("step_m", [0.3, 1.0, 4.0])
def test_the_runner_up_is_the_nearest_scan_at_least_10_m_away(step_m):
    tensor_map, images = sample_map(count=60, segment_length=20, step_m=step_m)
    localizer = Localizer(tensor_map)
    x_m = tensor_map.trajectory.poses[:, 0]
    for row in range(0, 60, 7):
        found = localizer.localize_image(sample_image(tensor_map, images[row]), k=60)
        away = [match for match in found.matches if abs(x_m[match.row] - x_m[row]) >= AWAY_M]
        assert found.runner_up == (away[0] if away else None)
        assert found.ratio == (found.best.distance / away[0].distance if away else None)


def test_without_poses_the_runner_up_is_at_least_50_scans_away_or_in_another_drive():
    tensor_map, images = sample_map(count=70, segment_length=20, drives=2, poses=False)
    localizer = Localizer(tensor_map)
    for row in range(0, 140, 11):
        found = localizer.localize_image(sample_image(tensor_map, images[row]), k=140)
        assert found.best.along_m is None
        assert found.best.pose is None
        away = [
            match
            for match in found.matches
            if match.row // 70 != row // 70 or abs(match.row - row) >= AWAY_SCANS
        ]
        assert found.runner_up == away[0]


def test_a_map_within_10_m_has_no_runner_up():
    tensor_map, images = sample_map(count=8, segment_length=4)
    found = Localizer(tensor_map).localize_image(sample_image(tensor_map, images[0]))
    assert found.runner_up is None
    assert found.ratio is None


def test_an_answer_without_its_runner_up_is_the_same_otherwise(monkeypatch):
    tensor_map, images = sample_map(count=60, segment_length=20)
    localizer, image = Localizer(tensor_map), sample_image(tensor_map, images[7])
    whole = localizer.localize_image(image, k=3)
    assert whole.runner_up is not None
    estimated = []

    def counted(*given):
        estimated.append(given)
        return match_at(*given)

    monkeypatch.setattr("core.localization.localizer.match_at", counted)
    without = localizer.localize_image(image, k=3, with_runner_up=False)
    assert without == replace(whole, runner_up=None)
    assert len(estimated) == 3


def test_two_places_with_the_same_image_are_ambiguous():
    tensor_map, images = sample_map(count=30, segment_length=30)
    twins = images.copy()
    twins[29] = twins[0]
    twin_map = fit_map(
        MemoryImages(twins, tensor_map.parameters.grid),
        tensor_map.trajectory,
        tensor_map.model.segment_start,
        tensor_map.parameters,
    )
    found = Localizer(twin_map).localize_image(sample_image(twin_map, twins[0]))
    assert found.best.row == 0
    assert found.runner_up is not None
    assert found.runner_up.row == 29
    assert found.ratio == pytest.approx(1.0)
    exact = Signature(twin_map.model.signatures[0], 0, twin_map.revision)
    if (twin_map.model.signatures[0] == twin_map.model.signatures[29]).all():
        assert Localizer(twin_map).localize_signatures([exact]).ratio == 1.0


def test_packed_signatures_find_what_the_whole_ones_do():
    drive = SimulatedDrive(seed=2, scans=120, stops=False, sensor=SimulatedSensor(firings=360))
    mapped = np.arange(0, 120, 2)
    parameters = MapParameters()
    projected = project_drive(drive, mapped, parameters.imager)
    trajectory = Trajectory.of_drive("d", drive.timestamp_s[mapped], drive.poses[mapped], mapped)
    localizer = Localizer(fit_map(projected.images, trajectory, cut_fixed(60, 20), parameters))
    queries = np.arange(1, 120, 2)
    same = 0
    for index in queries.tolist():
        signatures = localizer.basis.encode(localizer.basis.image(drive.scan(index)))
        body = pack_signatures(signatures)
        assert len(body) == 11 + 3 * 52
        packed = localizer.localize_signatures(unpack_signatures(body))
        same += packed.best.row == localizer.localize_signatures(signatures).best.row
    assert same >= 0.99 * len(queries)


def test_a_map_whose_parts_do_not_fit_is_rejected(made):
    tensor_map, _ = made
    short = tensor_map.trajectory.select(np.arange(47))
    node_beyond = Topology(
        tensor_map.topology.node_scan + 1,
        tensor_map.topology.edge_nodes,
        tensor_map.topology.edge_length_m,
    )
    turned_round = Topology(
        tensor_map.topology.node_scan,
        tensor_map.topology.edge_nodes[:, ::-1],
        tensor_map.topology.edge_length_m,
    )
    one = tensor_map.trajectory
    cut_elsewhere = Trajectory(
        one.drives, np.array([0, 20, 48]), np.r_[0:20, 0:28], one.timestamp_s, one.poses
    )
    parts = {
        "parameters": tensor_map.parameters,
        "model": tensor_map.model,
        "trajectory": tensor_map.trajectory,
        "topology": tensor_map.topology,
        "relative_error": tensor_map.relative_error,
    }
    for changes, message in (
        ({"trajectory": short}, "48 signatures and 47 scans"),
        ({"relative_error": np.zeros(5)}, "6 segments"),
        ({"relative_error": np.full(6, np.nan)}, "relative_error"),
        ({"relative_error": np.full(6, -0.1)}, "relative_error"),
        ({"topology": turned_round}, "are not between its edge's nodes"),
        ({"trajectory": cut_elsewhere}, "runs from one drive into the next"),
        ({"topology": node_beyond}, "node_scan names a scan that does not exist"),
        ({"parameters": MapParameters(grid=tensor_map.parameters.grid, ranks=(4, 3))}, "ranks"),
        ({"parameters": MapParameters(ranks=(3, 4))}, "not for the grid"),
    ):
        with pytest.raises(InvalidMap, match=message):
            TensorMap(**{**parts, **changes})
