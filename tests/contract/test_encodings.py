"""What every encoding promises, ours and one that no product code knows."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from app.jobs import runner
from app.localization.signature_schemas import SignaturesIn
from app.revisions.schemas import BasisOut
from core.encodings import registry
from core.encodings.registry import encoding_named, encoding_of_layout
from core.encodings.signature import Signature, pack_signatures, unpack_signatures
from core.errors import InvalidMap, InvalidParameters, InvalidSignature, StaleSignature
from core.evaluation.compare import ComparisonProtocol, compare
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.methods import MappedPlaces
from core.evaluation.pairing import HeldOut
from core.evaluation.split import Every
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.mapping.merge import merge_maps, without_drives
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.images import MemoryImages, project_drive
from core.scans.drive import MemoryDrive
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.tracking.track import Observation, Track, Tracker
from storage.files.map_file import read_map, write_map
from tests.support.block_means import BLOCK_MEANS, BlockMeans, run_job_with_block_means
from tests.support.recording import KITTI, kitti, recording
from tests.support.samples import random_images
from tests.support.service import running, upload, wait_for

ENCODINGS = ("paper", "harmonic", BLOCK_MEANS.name)
PACKED = {"Content-Type": "application/vnd.tensormap.signature"}


@pytest.fixture(scope="module", autouse=True)
def registered():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(registry, "_registered", {})
        registry.register(BLOCK_MEANS)
        yield


def parameters_of(name, **options):
    return MapParameters.for_sensor(encoding=name, ranks=(3, 4), **options)


def part(parameters, drive, count, seed, **options):
    """Return a map of one drive of random images, and the images."""
    shape = parameters.imager.shape
    cells = random_images(count * (shape[0] if len(shape) == 3 else 1), shape[-2:], seed)
    images = MemoryImages(cells.reshape(count, *shape), parameters.grid)
    trajectory = Trajectory.of_drive(
        drive, 0.1 * np.arange(count), np.full((count, 7), np.nan), np.arange(count)
    )
    cuts = cut_drives(trajectory.drive_start, 5)
    return fit_map(images, trajectory, cuts, parameters, **options)


@pytest.fixture(scope="module", params=ENCODINGS)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def drive():
    scans = recording(scans=24).scans
    return MemoryDrive("block", list(scans))


@pytest.fixture(scope="module")
def built(name, drive, registered):
    """A map of real projections."""
    parameters = parameters_of(name)
    projected = project_drive(drive, np.arange(len(drive)), parameters.imager)
    trajectory = Trajectory.of_drive("block", drive.timestamp_s, drive.poses, projected.scans)
    return fit_map(projected.images, trajectory, np.array([0, 12, 24]), parameters)


class TestEncodings:
    """Each promise is checked for every encoding."""

    def test_its_name_and_layouts_lead_to_it(self, name):
        encoding = encoding_named(name)
        assert encoding.name == name
        assert all(encoding_of_layout(layout) is encoding for layout in encoding.layouts)

    def test_parameters_survive_their_attributes(self, name):
        parameters = parameters_of(name)
        assert MapParameters.from_attributes(parameters.as_attributes()) == parameters
        assert parameters.encoder is encoding_named(name)

    def test_ranks_beyond_the_grid_are_rejected_and_the_largest_are_not(self, name):
        grid = parameters_of(name).grid
        r1, r2 = encoding_named(name).largest_ranks(grid.shape)
        MapParameters.for_sensor(encoding=name, ranks=(r1, r2))
        for ranks in ((r1 + 1, 1), (1, r2 + 1), (0, 1)):
            with pytest.raises(InvalidParameters, match=r"r[12] is \d+, wanted 1\.\."):
                MapParameters.for_sensor(encoding=name, ranks=ranks)

    def test_parameters_that_it_does_not_have_are_rejected(self, name):
        encoding = encoding_named(name)
        for option, value in (("distance", "plain"), ("lateral_renderings_m", [0.0])):
            if getattr(encoding, option) is None:
                with pytest.raises(InvalidParameters, match=f"{option} is no parameter"):
                    parameters_of(name, **{option: value})
            else:
                assert getattr(parameters_of(name, **{option: value}), option) is not None

    def test_its_arrays_are_those_that_a_file_holds(self, name, built):
        own = encoding_named(name).arrays_of(built.attributes())
        dtypes = {**own, "segment_start": "<i8"}
        arrays = built.model.arrays()
        assert {key: array.dtype.str for key, array in arrays.items()} == dtypes
        assert built.elements == encoding_named(name).elements(
            built.parameters, built.model.segments, len(built)
        )
        assert encoding_named(name).stored_bytes(
            built.parameters, built.model.segments, len(built)
        ) == sum(array.nbytes for key, array in arrays.items() if key != "segment_start")

    def test_a_map_file_holds_all_of_it(self, built, tmp_path):
        write_map(tmp_path / "map.h5", built)
        again = read_map(tmp_path / "map.h5")
        assert again.revision == built.revision
        assert again.basis_digests == built.basis_digests
        assert again.parameters == built.parameters

    def test_a_model_of_other_parameters_is_rejected(self, name, built):
        ranked = MapParameters.for_sensor(encoding=name, ranks=(2, 4))
        others = [MapParameters.for_sensor(encoding=other, ranks=(3, 4)) for other in ENCODINGS]
        for parameters in (ranked, *(p for p in others if p.encoding != name)):
            with pytest.raises(InvalidMap):
                TensorMap(
                    parameters,
                    built.model,
                    built.trajectory,
                    built.topology,
                    built.relative_error,
                )

    def test_every_scan_is_its_own_nearest_one(self, built, drive):
        localizer = Localizer(built)
        for row in (0, 11, 23):
            answer = localizer.localize_scan(drive.scan(row), k=3)
            assert answer.best.row == row
            distances = [match.distance for match in answer.matches]
            assert distances == sorted(distances)
            assert answer.best.distance == pytest.approx(0.0, abs=1e-2)

    def test_a_search_agrees_with_all_of_its_distances(self, built, drive):
        basis = built.basis()
        search = built.model.search(basis.encode(basis.image(drive.scan(3))))
        distances = search.distances()
        found = search.nearest(len(built))
        assert found.distances.tolist() == np.sort(distances).tolist()
        assert (distances[found.rows] == found.distances).all()
        among = np.arange(len(built)) % 3 == 1
        assert set(search.nearest(5, among).rows.tolist()) <= set(np.flatnonzero(among).tolist())
        assert np.isinf(search.distances(among)[~among]).all()
        assert len(search.nearest(5, np.zeros(len(built), bool))) == 0
        image = basis.image(drive.scan(3))
        by_values = built.model.search_values(basis.project(image), basis.view(image))
        assert by_values.segments == search.segments
        np.testing.assert_array_equal(by_values.distances(), distances)

    def test_its_own_queries_find_their_scans(self, built):
        localizer = Localizer(built)
        rows = range(0, len(built), 5)
        for row, query in zip(rows, built.model.own_queries(rows, built.basis_digest), strict=True):
            assert localizer.localize_signatures(query).best.row == row

    def test_a_signature_has_the_ranks_that_are_wanted_up_to_those_kept(self, built, drive):
        basis = built.basis()
        image, (r1, r2) = basis.image(drive.scan(3)), basis.kept_ranks
        signatures = basis.encode(image, (r1, r2))
        assert {one.values.shape for one in signatures} == {(r1, r2)}
        assert built.model.search(signatures).nearest(1).rows.tolist() == [3]
        with pytest.raises(InvalidParameters, match=f"this map takes .*{r1} x {r2}"):
            basis.encode(image, (r1, r2 + 1))

    def test_a_signature_survives_the_wire(self, built, drive):
        basis = built.basis()
        encoding = built.parameters.encoder
        signatures = basis.encode(basis.image(drive.scan(7)))
        for signature in signatures:
            values = encoding.as_values(signature)
            values.pop("encoding", None)
            again = encoding.from_values(values, signature.revision)
            assert (again.segment, again.encoding) == (signature.segment, encoding.name)
            np.testing.assert_array_equal(again.values, signature.values)
        for packing in encoding.packings:
            unpacked = unpack_signatures(pack_signatures(signatures, packing))
            assert [s.segment for s in unpacked] == [s.segment for s in signatures]
            for one, other in zip(unpacked, signatures, strict=True):
                most = np.abs(other.values).max()
                np.testing.assert_allclose(one.values, other.values, atol=0.01 * most)

    @settings(max_examples=50, deadline=None)
    @given(body=st.binary(max_size=80))
    @example(body=b"\x01\x7c" * 10)  # signalling NaNs, as float16
    def test_any_bytes_are_its_signatures_or_rejected(self, name, body):
        layout = min(encoding_named(name).layouts)
        try:
            unpacked = unpack_signatures(bytes([layout]) + bytes(8) + bytes([2, 3]) + body)
        except InvalidSignature:
            return
        assert all(s.values.shape == (2, 3) and s.encoding == name for s in unpacked)

    def test_a_basis_survives_its_values_and_makes_the_same_signatures(self, built, drive):
        basis = built.basis()
        again = built.parameters.encoder.read_basis(
            basis.revision, basis.digest, basis.parameters, {"segments": [], **basis.as_values()}
        )
        image = basis.image(drive.scan(5))
        for one, other in zip(again.encode(image), basis.encode(image), strict=True):
            np.testing.assert_array_equal(one.values, other.values)
            assert (one.segment, one.revision) == (other.segment, basis.digest)

    def test_maps_merge_exactly_and_drives_are_left_out_exactly(self, name):
        parameters = parameters_of(name)
        first = part(parameters, "a", 12, 1)
        kept = first.basis() if encoding_named(name).shares_basis else None
        second = part(parameters, "b", 7, 2, kept=kept)
        merged = merge_maps([first, second])
        assert merged.model.signatures[:12].tobytes() == first.model.signatures.tobytes()
        assert merged.model.signatures[12:].tobytes() == second.model.signatures.tobytes()
        assert without_drives(merged, ["b"]).revision == first.revision
        assert without_drives(merged, ["a"]).revision == second.revision
        assert set(first.basis_digests) <= set(merged.basis_digests)

    def test_a_basis_is_kept_where_segments_share_one_and_rejected_elsewhere(self, name):
        parameters = parameters_of(name)
        first = part(parameters, "a", 12, 1)
        assert first.basis().serves(parameters) is encoding_named(name).shares_basis
        if first.basis().serves(parameters):
            kept = part(parameters, "b", 7, 2, kept=first.basis())
            assert kept.basis_digest == first.basis_digest
        else:
            with pytest.raises(InvalidParameters, match="cannot be kept"):
                part(parameters, "b", 7, 2, kept=first.basis())
        other = part(MapParameters.for_sensor(encoding=name, ranks=(12, 4)), "c", 7, 3)
        with pytest.raises(InvalidParameters, match="cannot be kept"):
            part(parameters, "b", 7, 2, kept=other.basis())

    def test_signatures_of_another_basis_or_encoding_are_rejected(self, name, built, drive):
        localizer = Localizer(built)
        own = localizer.basis.encode(localizer.basis.image(drive.scan(0)))
        stale = [Signature(s.values, s.segment, "f" * 64, s.encoding) for s in own]
        with pytest.raises(StaleSignature):
            localizer.localize_signatures(stale)
        for other in ENCODINGS:
            if other != name:
                segment = 0 if encoding_named(other).per_segment else None
                foreign = Signature(np.ones((3, 4), np.float32), segment, built.revision, other)
                with pytest.raises(InvalidSignature):
                    localizer.localize_signatures([foreign])

    def test_a_track_follows_a_drive(self, built, drive):
        tracker = Tracker(Localizer(built))
        track = Track(tracker)
        basis = built.basis()
        for index in range(6, 14):
            scan = drive.scan(index)
            step = track.observe(Observation(basis.encode(basis.image(scan))))
        assert abs(step.row - 13) <= 1
        assert step.match.row == step.row

    def test_it_is_evaluated_and_compared(self, name, drive):
        parameters = parameters_of(name)
        found = evaluate(drive, EvaluationProtocol(parameters, segments=2))
        assert found.encoding == name
        assert found.conditions[0].queries > 0
        compared = compare(
            drive, [MappedPlaces(parameters, 12)], ComparisonProtocol(HeldOut(Every(5)))
        )
        assert [of.name for of in compared.methods] == [name]

    def test_it_is_served(self, name, tmp_path, monkeypatch):
        monkeypatch.setattr(runner, "run_job", run_job_with_block_means)
        with running(tmp_path / "data") as client:
            client.post("/v1/maps", json={"map": "campus"})
            upload(client, "monday", recording())
            body = {"encoding": name, "segments": 2}
            queued = client.post("/v1/maps/campus/builds", json=body)
            assert queued.status_code == 202, queued.text
            job = wait_for(client, queued.json()["job"])
            assert (job["state"], job["error"]) == ("done", None)
            revision = client.get(f"/v1/maps/campus/revisions/{job['revision']}").json()
            assert (revision["encoding"], revision["scans"]) == (name, len(recording()))

            scan = recording().scans[20]
            places = "/v1/maps/campus/localizations"
            by_scan = client.post(f"{places}/scan", content=kitti(scan), headers=KITTI).json()
            assert by_scan["best"]["scan_index"] == 20
            downloaded = client.get("/v1/maps/campus/basis")
            basis = BasisOut.model_validate(downloaded.json()).to_core()
            signatures = basis.encode(basis.image(scan))
            packed = pack_signatures(signatures)
            answer = client.post(f"{places}/signature", content=packed, headers=PACKED).json()
            assert answer["best"]["scan_index"] == 20
            values = [basis.parameters.encoder.as_values(s) for s in signatures]
            body = {"basis": basis.digest, "signatures": values}
            by_values = client.post(f"{places}/signature", json=body).json()
            if name == "harmonic":  # a scan is compared by more than its signature
                assert by_values["best"]["scan_index"] == 20
            else:
                assert by_values == by_scan


@pytest.mark.parametrize(
    "item",
    [
        5,
        [],
        "paper",
        {"encoding": "fourier", "means": [[1.0]]},
        {"encoding": "paper", "segment": 0, "values": [[1.0]]},
        {"encoding": ["block-means"]},
        {"encoding": None, "segment": 0, "values": [[1.0]]},
    ],
)
def test_invalid_signatures_of_a_registered_encoding_are_rejected(item):
    with pytest.raises(ValidationError):
        SignaturesIn.model_validate({"basis": "0f" * 32, "signatures": [item]})


@pytest.mark.parametrize("means", [5, [[]], [[1.0], [1.0, 2.0]], [["x"]], [[float("nan")]]])
def test_a_registered_encoding_rejects_values_that_are_no_signature(means):
    item = {"encoding": BLOCK_MEANS.name, "means": means}
    sent = SignaturesIn.model_validate({"basis": "0f" * 32, "signatures": [item]})
    with pytest.raises(InvalidSignature):
        sent.to_core()


def test_an_unknown_encoding_is_rejected_and_the_known_are_listed():
    with pytest.raises(InvalidParameters, match="is 'fourier', wanted paper, harmonic, block-mea"):
        encoding_named("fourier")
    with pytest.raises(InvalidSignature, match=r"layout 99 is unknown, wanted 1 \(float16\), 2"):
        encoding_of_layout(99)


def test_a_name_and_a_layout_are_registered_once():
    with pytest.raises(InvalidParameters, match="an encoding 'block-means' already"):
        registry.register(BLOCK_MEANS)

    class Other(BlockMeans):
        name = "other"

    with pytest.raises(InvalidParameters, match=r"layout 200 .* is that of block-means"):
        registry.register(Other())
