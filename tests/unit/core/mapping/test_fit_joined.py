"""Drives that meet become one graph, from the build to the file and the answer."""

import json

import h5py
import numpy as np
import pytest

from app.builds.drive_build import build_drives
from app.builds.parameters import BuildParameters
from app.revisions.topology_schemas import TopologyOut
from core.errors import InvalidMap
from core.localization.localizer import Localizer
from core.mapping.fit import fit_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters, Segmentation
from core.projection.images import MemoryImages
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_drives
from core.simulation import SimulatedDrive
from core.simulation.raycast import SimulatedSensor
from core.topology import Topology, cut_at_meetings
from storage.errors import CorruptFile
from storage.files.map_file import read_map, write_map
from tests.support.commands import run
from tests.support.samples import SMALL_GRID, random_images, sample_image, straight_poses

pytestmark = pytest.mark.slow


def made(*drives) -> tuple[TensorMap, np.ndarray]:
    """Return a map of drives given by their poses, and its images."""
    trajectory = Trajectory.concatenate(
        [
            Trajectory.of_drive(f"d{i}", np.arange(len(p)) / 10.0, p, np.arange(len(p)))
            for i, p in enumerate(drives)
        ]
    )
    images = random_images(len(trajectory), SMALL_GRID.shape)
    cuts = cut_at_meetings(trajectory, cut_drives(trajectory.drive_start, 25))
    parameters = MapParameters(grid=SMALL_GRID, ranks=(3, 4), sensor="hdl-64e")
    return fit_map(MemoryImages(images, SMALL_GRID), trajectory, cuts, parameters), images


@pytest.fixture(scope="module")
def there_and_back():
    there = straight_poses(80, 1.5)
    return made(there, there[::-1])


def test_a_second_drive_along_a_street_has_its_own_models_and_the_first_ones_edges(there_and_back):
    tensor_map, _ = there_and_back
    assert tensor_map.model.segments == 6
    assert tensor_map.topology.edge_of_segment.tolist() == [0, 1, 2, 2, 1, 0]
    assert tensor_map.topology.segment_reversed.tolist() == [False] * 3 + [True] * 3
    assert tensor_map.topology.edge_length_m.sum() == 79 * 1.5


def test_fraction_and_metres_are_those_of_the_segment(there_and_back):
    tensor_map, images = there_and_back
    localizer = Localizer(tensor_map)
    for row in range(0, 160, 7):
        best = localizer.localize_image(sample_image(tensor_map, images[row])).best
        first, last = tensor_map.segment_ends[best.segment].tolist()
        assert best.row == row
        assert best.fraction == (row - first) / (last - first)
        assert best.along_m == pytest.approx(1.5 * (row - first))


def test_a_joined_map_is_read_from_its_file_to_the_bit(there_and_back, tmp_path):
    tensor_map, _ = there_and_back
    write_map(tmp_path / "map.h5", tensor_map)
    again = read_map(tmp_path / "map.h5")
    assert again.revision == tensor_map.revision
    assert again.topology.segment_reversed.tolist() == [False] * 3 + [True] * 3
    with h5py.File(tmp_path / "map.h5") as file:
        kinds = {
            name: file[name].dtype.str for name in file if "segment_" in name or "edge" in name
        }
    assert kinds == {
        "edge_length_m": "<f8", "edge_nodes": "<i8", "edge_of_segment": "<i8",
        "edge_scans": "<i8", "segment_reversed": "|i1", "segment_start": "<i8",
    }  # fmt: skip


def test_a_map_whose_segments_are_its_edges_holds_no_more_than_before():
    tensor_map, _ = made(straight_poses(80, 1.5))
    assert tensor_map.topology.is_plain
    assert not {"edge_scans", "edge_of_segment", "segment_reversed"} & set(tensor_map.arrays())


@pytest.mark.parametrize("name", ["edge_scans", "edge_of_segment", "segment_reversed"])
def test_a_file_lacks_none_of_the_arrays_of_a_joined_map(there_and_back, tmp_path, name):
    write_map(tmp_path / "map.h5", there_and_back[0])
    with h5py.File(tmp_path / "map.h5", "r+") as file:
        del file[name]
    with pytest.raises(CorruptFile, match=f"lacks or should not hold {name}"):
        read_map(tmp_path / "map.h5")


@pytest.mark.parametrize(("name", "value"), [("edge_scans", 7), ("segment_reversed", 2)])
def test_other_lengths_or_directions_have_another_digest(there_and_back, tmp_path, name, value):
    write_map(tmp_path / "map.h5", there_and_back[0])
    with h5py.File(tmp_path / "map.h5", "r+") as file:
        file[name][-1] = value
    with pytest.raises(CorruptFile, match=r"its content is|holds no map"):
        read_map(tmp_path / "map.h5")


def test_nodes_that_are_no_ends_of_their_segments_are_rejected(there_and_back):
    tensor_map, _ = there_and_back
    graph = tensor_map.topology
    for nodes in (graph.node_scan + 1, np.zeros_like(graph.node_scan) + 5, graph.node_scan[::-1]):
        moved = Topology(
            nodes, graph.edge_nodes, graph.edge_length_m, graph.edge_scans,
            graph.edge_of_segment, graph.segment_reversed,
        )  # fmt: skip
        with pytest.raises(InvalidMap, match="first segment end at its place"):
            TensorMap(
                tensor_map.parameters, tensor_map.model, tensor_map.trajectory, moved,
                tensor_map.relative_error,
            )  # fmt: skip


def test_the_graph_is_shown_with_all_segments_along_an_edge(there_and_back, tmp_path):
    tensor_map, _ = there_and_back
    shown = TopologyOut.from_core(tensor_map)
    assert [(edge.edge, edge.segment, edge.nodes) for edge in shown.edges] == [
        (0, 0, (0, 1)), (1, 1, (1, 2)), (2, 2, (2, 3))
    ]  # fmt: skip
    assert [[(s.segment, s.reversed) for s in edge.segments] for edge in shown.edges] == [
        [(0, False), (5, True)], [(1, False), (4, True)], [(2, False), (3, True)]
    ]  # fmt: skip
    write_map(tmp_path / "map.h5", tensor_map)
    facts = run("inspect", tmp_path / "map.h5", "--json")
    assert json.loads(facts)["edges"] == [edge.model_dump(mode="json") for edge in shown.edges]
    assert "4 nodes, 3 edges" in run("inspect", tmp_path / "map.h5")


@pytest.fixture(scope="module")
def rounds():
    """Twice round a block, in few scans of a coarse sensor."""
    return SimulatedDrive(
        seed=4, scans=130, speed_m_s=50.0, loop_m=280.0, stops=False,
        sensor=SimulatedSensor(firings=120),
    )  # fmt: skip


@pytest.mark.parametrize("segmentation", Segmentation)
def test_a_drive_that_closes_a_loop_joins_its_own_graph(rounds, segmentation):
    parameters = BuildParameters(segment_length=30, segmentation=segmentation, encoding="paper")
    built = build_drives([rounds], parameters)
    graph = built.tensor_map.topology
    assert built.tensor_map.parameters.segmentation == segmentation
    assert graph.edges < len(graph.edge_of_segment)
    assert not graph.segment_reversed.any()
    # Once round, and no longer: what came again is not counted again.
    assert graph.edge_length_m.sum() == pytest.approx(rounds.route.length_m, rel=0.05)
    for node in range(len(graph.node_scan)):
        assert graph.segments_at(node)
