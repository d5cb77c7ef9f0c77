"""A harmonic map, from its parameters to its answers."""

import numpy as np
import pytest
from scipy.linalg import eigh

from core.encodings.distance import Distance
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.numbers import SignatureNumbers
from core.encodings.harmonics import azimuth_factor
from core.encodings.signature import Packing, Signature, pack_signatures, unpack_signatures
from core.errors import (
    InvalidMap,
    InvalidParameters,
    InvalidSignature,
    SensorMismatch,
    StaleSignature,
)
from core.evaluation.condition import Condition
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Image, ImageKind
from core.projection.images import ConcatenatedImages, MemoryImages, project_drive
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.scans.drive import MemoryDrive
from core.scans.pose import heading_deg
from core.scans.sensor import AngularGrid
from core.scans.trajectory import Trajectory
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from tests.support.samples import sample_harmonic_map, straight_poses

pytestmark = pytest.mark.slow

HARMONIC, PAPER = "harmonic", "paper"


@pytest.fixture(scope="module")
def drive():
    sensor = SimulatedSensor(firings=360)
    return MemoryDrive("d", list(SimulatedDrive(seed=1, scans=60, stops=False, sensor=sensor)))


def map_of(drive, **options):
    parameters = MapParameters.for_sensor(encoding=HARMONIC, **options)
    mapped = np.arange(0, len(drive), 2)
    images = project_drive(drive, mapped, parameters.imager).images
    trajectory = Trajectory.of_drive("d", drive.timestamp_s[mapped], drive.poses[mapped], mapped)
    return fit_map(images, trajectory, np.array([0, 14, len(mapped)]), parameters)


@pytest.fixture(scope="module")
def localizer(drive):
    return Localizer(map_of(drive))


# Parameters


def test_the_defaults_are_highest_returns_normalised_and_five_renderings():
    parameters = MapParameters.for_sensor(encoding=HARMONIC)
    assert parameters.image == ImageKind.HEIGHT
    assert parameters.grid == RingGrid()
    assert parameters.reducer == Reducer.HIGHEST
    assert parameters.distance == Distance.NORMALISED
    assert parameters.lateral_renderings_m == (-3.0, -1.5, 0.0, 1.5, 3.0)


def test_range_images_are_on_the_sensors_grid_without_a_seam():
    parameters = MapParameters.for_sensor("vlp-16", encoding=HARMONIC, image=ImageKind.RANGE)
    assert parameters.grid.shape == (16, 360)
    assert parameters.image == ImageKind.RANGE


@pytest.mark.parametrize(
    "options",
    [
        {"encoding": HARMONIC, "ranks": (21, 5)},
        {"encoding": HARMONIC, "ranks": (5, 182)},
        {"encoding": HARMONIC, "reducer": Reducer.LAST},
        {"encoding": HARMONIC, "image": ImageKind.RANGE, "reducer": Reducer.HIGHEST},
        {"encoding": HARMONIC, "lateral_renderings_m": []},
        {"encoding": PAPER, "image": ImageKind.HEIGHT},
        {"encoding": PAPER, "reducer": Reducer.HIGHEST},
        {"encoding": PAPER, "distance": Distance.PLAIN},
        {"encoding": PAPER, "lateral_renderings_m": [0.0]},
    ],
)
def test_parts_that_do_not_fit_are_rejected(options):
    with pytest.raises(InvalidParameters):
        MapParameters.for_sensor(**options)


def test_a_grid_with_a_seam_is_rejected():
    with pytest.raises(InvalidParameters, match="wraps"):
        MapParameters(HARMONIC, grid=AngularGrid())
    with pytest.raises(InvalidParameters, match="needs distance"):
        MapParameters(HARMONIC, grid=AngularGrid(wraps=True))


@pytest.mark.parametrize("image", list(ImageKind))
def test_parameters_come_back_from_their_attributes(image):
    parameters = MapParameters.for_sensor(
        encoding=HARMONIC, image=image, distance=Distance.PLAIN, lateral_renderings_m=[-1, 0.0]
    )
    assert MapParameters.from_attributes(parameters.as_attributes()) == parameters


def test_a_paper_maps_attributes_are_those_it_always_had():
    assert set(MapParameters().as_attributes()) == {
        "encoding", "ranks", "reducer", "sensor", "grid", "sensor_height_m"
    }  # fmt: skip


# Building


def test_one_basis_is_the_best_for_the_detail_in_all_renderings_of_all_segments():
    tensor_map, images = sample_harmonic_map(count=40, segment_length=15)
    spectrum = np.fft.fft(images.astype(float), axis=-1)
    finer_than_24_deg = np.abs(np.fft.fftfreq(images.shape[-1], 1 / images.shape[-1])) >= 360 / 24
    finer_than_24_deg[images.shape[-1] // 2] = True  # on a small grid the finest wave is detail
    detail = np.fft.ifft(spectrum * finer_than_24_deg, axis=-1).real
    matrix = np.einsum("kdij,kdlj->il", detail, detail)
    matrix += 1e-6 * np.einsum("kdij,kdlj->il", images.astype(float), images.astype(float))
    u = eigh(matrix)[1][:, ::-1][:, :3]
    model = tensor_map.model
    assert isinstance(model, HarmonicModel)
    np.testing.assert_allclose(
        np.abs(np.sum(u * model.radial_basis, axis=0)), np.ones(3), atol=1e-5
    )
    assert (model.radial_basis[np.abs(model.radial_basis).argmax(axis=0), range(3)] > 0).all()
    factor = azimuth_factor(images.shape[-1], 4)
    expected = np.einsum("ir,kdij,jm->kdrm", model.radial_basis, images, factor, optimize=True)
    largest = np.abs(expected).max(axis=(2, 3), keepdims=True)
    assert (np.abs(model.signatures - expected) <= 0.75 * largest / 127).all()  # of half a code


def test_the_relative_error_is_what_the_reconstruction_misses():
    tensor_map, images = sample_harmonic_map(count=20, segment_length=10)
    model = tensor_map.model
    assert isinstance(model, HarmonicModel)
    columns = images.shape[-1]
    factor = azimuth_factor(columns, 4)
    w = np.array([1.0, 2.0, 2.0, 2.0])
    rebuilt = np.einsum(
        "ir,kdrm,jm->kdij", model.radial_basis, model.signatures * w, factor.conj(), optimize=True
    ).real
    for segment in range(2):
        own = slice(10 * segment, 10 * segment + 10)
        error = np.linalg.norm(images[own] - rebuilt[own]) / np.linalg.norm(images[own])
        assert tensor_map.relative_error[segment] == pytest.approx(error, abs=1e-4)


def test_streamed_is_whole_and_parts_are_one():
    tensor_map, images = sample_harmonic_map(count=70, segment_length=40)
    parts = [
        MemoryImages(part, tensor_map.parameters.grid) for part in np.split(images, [1, 33, 50])
    ]
    again = fit_map(
        ConcatenatedImages(parts),
        tensor_map.trajectory,
        tensor_map.model.segment_start,
        tensor_map.parameters,
    )
    assert again.revision == tensor_map.revision


def test_the_elements_are_those_of_the_arrays():
    tensor_map, _ = sample_harmonic_map(count=10, segment_length=5)
    # I r1, D offsets, and 3 x (2 x 4 - 1) reals for each of 10 scans' 3 renderings.
    assert tensor_map.elements == 6 * 3 + 3 + 10 * 3 * 3 * 7


def test_a_map_whose_parts_do_not_fit_is_rejected():
    tensor_map, _ = sample_harmonic_map(count=10, segment_length=5)
    model = tensor_map.model
    assert isinstance(model, HarmonicModel)
    numbers = model.signatures
    imaginary = numbers.copy()
    imaginary[0, 0, 0, 0] += 1j
    for wrong in (imaginary, np.full_like(imaginary, np.nan), numbers[0]):
        with pytest.raises(InvalidMap):
            SignatureNumbers(wrong)
    for name, value in (
        ("stored", SignatureNumbers(numbers[:9])),
        ("stored", SignatureNumbers(numbers[:, :2])),
        ("stored", model.stored.select(np.arange(9))),
        ("stored", model.stored.limited(2)),
        ("radial_basis", model.radial_basis[:, :2]),
        ("radial_basis", model.radial_basis[0]),
        ("lateral_offset_m", np.array([-2.0, 0.0, np.inf])),
        ("segment_start", np.array([0, 5, 5, 10])),
        ("columns", 4),
    ):
        with pytest.raises(InvalidMap):
            HarmonicModel(**{**vars_of(model), name: value})
    other = HarmonicModel(**{**vars_of(model), "lateral_offset_m": np.array([-1.0, 0.0, 1.0])})
    plain = HarmonicModel(**{**vars_of(model), "measure": Distance.PLAIN})
    parts = (tensor_map.trajectory, tensor_map.topology, tensor_map.relative_error)
    for misfit, message in ((other, "lateral_offset_m"), (plain, "distance")):
        with pytest.raises(InvalidMap, match=message):
            TensorMap(tensor_map.parameters, misfit, *parts)


def vars_of(model):
    names = ("radial_basis", "stored", "lateral_offset_m", "segment_start", "columns")
    others = {"measure": model.measure, "sent_ranks": model.sent_ranks}
    return {**{name: getattr(model, name) for name in names}, **others}


# Answering


def test_every_rendering_finds_its_scan_and_its_viewpoint():
    tensor_map, images = sample_harmonic_map(count=20, segment_length=10)
    localizer = Localizer(tensor_map)
    grid = tensor_map.parameters.grid
    assert isinstance(grid, RingGrid)
    for row in range(0, 20, 3):
        for rendering, left_m in enumerate((-2.0, 0.0, 2.0)):
            rolled = np.roll(images[row, rendering], -5, axis=1)
            found = localizer.localize_image(Image(rolled, grid))
            assert found.best.row == row
            assert found.best.lateral_m == pytest.approx(left_m, abs=1e-9)
            assert found.best.relative_yaw_deg == pytest.approx(5 * 20, abs=2)
            assert found.segments == (0, 1)


@pytest.mark.parametrize("lateral_m", [-3.0, 0.0, 1.5])
@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, -120.0, 180.0])
def test_a_vehicle_with_an_offset_and_relative_yaw_is_found_at_its_place(
    drive, localizer, lateral_m, yaw_deg
):
    condition = Condition(yaw_deg=yaw_deg, lateral_m=lateral_m)
    for index in range(4, 60, 10):  # scans of the map itself: the answer is exact
        scan = condition.apply(drive.scan(index), np.random.default_rng(0))
        of_scan = localizer.localize_scan(scan).best  # by images, whose cells are metres wide
        assert of_scan.scan_index == index
        assert of_scan.lateral_m == pytest.approx(lateral_m, abs=0.5)
        signatures = localizer.basis.encode(localizer.basis.image(scan))
        best = localizer.localize_signatures(signatures).best
        assert best.scan_index == index
        assert best.lateral_m == pytest.approx(lateral_m, abs=1e-6)
        assert best.estimated_pose is not None
        truth = condition.pose(drive.poses[index])
        estimate = np.array(best.estimated_pose.as_tuple())
        np.testing.assert_allclose(estimate[:3], truth[:3], atol=1e-6)
        error = (heading_deg(estimate[None]) - heading_deg(truth[None]) + 180) % 360 - 180
        assert abs(error) < 0.6
        assert best.heading_deg == pytest.approx(heading_deg(estimate[None])[0])
        yaw_error = (best.relative_yaw_deg - yaw_deg + 180) % 360 - 180
        assert abs(yaw_error) < 0.6


@pytest.mark.parametrize(
    "options",
    [
        {"image": ImageKind.RANGE},
        {"image": ImageKind.RANGE, "reducer": Reducer.NEAREST, "lateral_renderings_m": [0.0]},
        {"reducer": Reducer.HIGHEST, "distance": Distance.PLAIN},
        {"ranks": (3, 7)},
    ],
)
def test_every_choice_finds_a_neighbour_with_relative_yaw(drive, options):
    localizer = Localizer(map_of(drive, **options))
    condition = Condition(yaw_deg=75.0)
    near, heading_errors_deg = [], []
    for index in range(1, 60, 4):
        scan = condition.apply(drive.scan(index), np.random.default_rng(0))
        best = localizer.localize_scan(scan).best
        near.append(abs(best.scan_index - index) <= 2)
        assert best.heading_deg is not None
        truth = heading_deg(condition.pose(drive.poses[index])[None])[0]
        heading_errors_deg.append(abs((best.heading_deg - truth + 180) % 360 - 180))
    assert np.mean(near) >= 0.9
    assert np.median(heading_errors_deg) < 3


def test_without_poses_relative_yaw_and_offset_are_still_estimated():
    tensor_map, images = sample_harmonic_map(count=10, segment_length=5, poses=False)
    grid = tensor_map.parameters.grid
    assert isinstance(grid, RingGrid)
    best = Localizer(tensor_map).localize_image(Image(images[4, 2], grid)).best
    assert best.row == 4
    assert best.lateral_m == pytest.approx(2.0, abs=1e-9)
    assert best.relative_yaw_deg == pytest.approx(0.0, abs=2)
    assert (best.estimated_pose, best.heading_deg) == (None, None)


def test_packed_signatures_find_what_the_whole_ones_do(drive, localizer):
    same: dict[Packing, list[bool]] = {packing: [] for packing in Packing}
    for index in range(1, 60, 2):
        signatures = localizer.basis.encode(localizer.basis.image(drive.scan(index)))
        whole = localizer.localize_signatures(signatures)
        for packing, of_it in same.items():
            body = pack_signatures(signatures, packing)
            assert len(body) <= {Packing.INT8: 99, Packing.FLOAT16: 175}[packing]
            of_it.append(
                localizer.localize_signatures(unpack_signatures(body)).best.row == whole.best.row
            )
    assert np.mean(same[Packing.FLOAT16]) >= 0.95
    assert np.mean(same[Packing.INT8]) >= 0.9


def test_the_basis_is_one_for_all_segments(localizer):
    basis = localizer.map.basis([1])
    assert isinstance(basis, HarmonicBasis)
    np.testing.assert_array_equal(basis.radial_basis, localizer.map.model.radial_basis)


def test_values_of_another_kind_are_rejected(drive, localizer):
    angular = AngularGrid(wraps=True)
    with pytest.raises(SensorMismatch, match="a range image, the map is of height images"):
        localizer.localize_image(Image(np.ones(angular.shape, np.float32), angular))
    rings = RingGrid(rings=10)
    with pytest.raises(SensorMismatch, match="the image is on"):
        localizer.localize_image(Image(np.ones(rings.shape, np.float32), rings))
    [signature] = localizer.basis.encode(localizer.basis.image(drive.scan(0)))
    with pytest.raises(InvalidSignature, match="exactly one harmonic signature"):
        localizer.localize_signatures([signature, signature])
    of_paper = Signature(signature.values.real, 0, signature.revision)
    with pytest.raises(InvalidSignature, match="exactly one harmonic signature"):
        localizer.localize_signatures([of_paper])
    with pytest.raises(StaleSignature):
        localizer.localize_signatures([Signature(signature.values, None, "f" * 64)])


def test_a_paper_map_rejects_a_harmonic_signature():
    parameters = MapParameters(ranks=(2, 2))
    images = np.random.default_rng(0).random((3, 30, 361), dtype=np.float32)
    trajectory = Trajectory.of_drive("d", np.arange(3.0), straight_poses(3), np.arange(3))
    tensor_map = fit_map(
        MemoryImages(images, parameters.grid), trajectory, np.array([0, 3]), parameters
    )
    harmonic = Signature(np.ones((2, 2), np.complex64), None, tensor_map.revision)
    with pytest.raises(InvalidSignature, match="harmonic"):
        Localizer(tensor_map).localize_signatures([harmonic])
    found = Localizer(tensor_map).localize_image(Image(images[1], AngularGrid())).best
    assert (found.relative_yaw_deg, found.lateral_m, found.heading_deg, found.estimated_pose) == (
        None,
    ) * 4


@pytest.mark.parametrize(
    ("values", "segment", "message"),
    [
        (np.ones((2, 2), np.complex64), 0, "complex"),
        (np.full((2, 2), 1j), None, "first column"),
        (np.full((2, 2), np.inf), None, "not finite"),
    ],
)
def test_an_invalid_harmonic_signature_is_rejected(values, segment, message):
    with pytest.raises(InvalidSignature, match=message):
        Signature(values, segment, "f" * 64)


def test_signatures_that_cannot_be_packed_or_unpacked_are_rejected():
    one = Signature(np.ones((2, 2), np.complex64), None, "f" * 64)
    with pytest.raises(InvalidSignature, match="alone"):
        pack_signatures([one, one])
    with pytest.raises(InvalidSignature, match="only a harmonic"):
        pack_signatures([Signature(np.ones((2, 2), np.float32), 0, "f" * 64)], Packing.INT8)
    large = Signature(np.full((2, 2), 1e6, np.complex64), None, "f" * 64)
    with pytest.raises(InvalidSignature, match="beyond float16"):
        pack_signatures([large], Packing.FLOAT16)
    assert unpack_signatures(pack_signatures([large]))[0].values[0, 0] == pytest.approx(1e6)
    for packing in Packing:
        body = pack_signatures([one], packing)
        for wrong in (body[:-1], body + b"\0", body[:11]):
            with pytest.raises(InvalidSignature, match=r"wanted .* bytes.*, got"):
                unpack_signatures(wrong)
    scaled = bytearray(pack_signatures([one]))
    for scale in (np.nan, np.inf, 3e38):
        scaled[11:15] = np.float32(scale).tobytes()
        with pytest.raises(InvalidSignature, match="not finite"):
            unpack_signatures(bytes(scaled))
    for scale, shown in ((-0.5, "-0.5"), (-np.inf, "-inf")):
        scaled[11:15] = np.float32(scale).tobytes()
        with pytest.raises(InvalidSignature, match=f"scale of its numbers is {shown}, wanted 0"):
            unpack_signatures(bytes(scaled))
