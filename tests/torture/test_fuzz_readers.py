"""Every reader gives a value or an error of ours, in bounded time, whatever it reads.

`TENSORMAP_TORTURE_INPUTS=20000` is a long run. What an earlier one found is in the unit tests of
the reader that it broke.
"""

import random
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

from app.access.key_schemas import KeyIn
from app.drives.pose_files import CSV, KITTI, TUM, read_poses
from app.drives.pose_schemas import PosesIn
from app.http.bodies.content_encoding import decoder_of
from app.maps.schemas import MapIn
from app.revisions.schemas import BasisOut
from app.revisions.topology_schemas import TopologyOut
from core.encodings.signature import Packing, pack_signatures, unpack_signatures
from core.errors import TensorMapError
from core.mapping.tensormap import TensorMap
from core.scans.pose import Pose, first_invalid
from core.scans.scan import Scan
from storage.formats.drives.layouts import open_drive
from storage.formats.scans.registry import FORMAT_NAMES, read_scan
from tests.support.recording import tar_members
from tests.support.samples import calibrated_map, sample_harmonic_map, sample_map
from tests.torture.reader_inputs import CLOUD, INPUTS, SEED, damaged, samples
from tests.torture.support.costs import forget_peak, peak_kb

pytestmark = pytest.mark.torture

MOST_CPU_S = 2.0  # of one input; the slowest whole one takes 0.1 s
MOST_GROWTH_KB = 200 * 1024  # of this process, over all inputs of a reader

WHOLE = samples()


def chance_of(name: str) -> random.Random:
    return random.Random(f"{SEED} {name}")


def attack(name: str, inputs: Iterator[Callable[[], object]]) -> None:
    """Call each; let only values and errors of ours pass, and no long time."""
    forget_peak()
    before_kb = peak_kb()
    for number in range(INPUTS):
        read = next(inputs)
        start_s = time.process_time()
        try:
            with suppress(TensorMapError):
                read()
        except Exception as error:
            raise AssertionError(f"seed {SEED}, input {number} of {name}: {error!r}") from error
        cpu_s = time.process_time() - start_s
        assert cpu_s < MOST_CPU_S, f"seed {SEED}, input {number} of {name} took {cpu_s:.1f} s"
    growth_kb = peak_kb() - before_kb
    assert growth_kb < MOST_GROWTH_KB, f"seed {SEED}: {name} grew by {growth_kb} KB"


def bodies(name: str, read: Callable[[bytes], object]) -> Iterator[Callable[[], object]]:
    chance = chance_of(name)
    while True:
        body = damaged(chance.choice(WHOLE[name]), chance)
        yield lambda body=body: read(body)  # type: ignore[misc]


@pytest.mark.parametrize("name", FORMAT_NAMES)
def test_a_damaged_scan_is_a_scan_or_refused(name: str) -> None:
    media_type = FORMAT_NAMES[name]
    attack(name, bodies(name, lambda body: read_scan(body, media_type=media_type, min_returns=1)))


@pytest.mark.parametrize(
    ("name", "kind"), [("poses.kitti", KITTI), ("poses.tum", TUM), ("poses.csv", CSV)]
)
def test_a_damaged_file_of_poses_is_poses_or_refused(name: str, kind: str) -> None:
    def read(body: bytes) -> None:
        found = read_poses(body, kind)
        assert first_invalid(found.poses) is None
        assert (np.diff(found.scans) > 0).all()
        assert not np.isinf(found.timestamps_s).any()

    attack(name, bodies(name, read))


def test_a_damaged_tar_stream_is_files_or_refused() -> None:
    def read(body: bytes) -> None:
        for member in tar_members(body, 2**20):
            member.name.encode()

    attack("tar", bodies("tar", read))


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
def test_a_damaged_packed_body_unpacks_or_is_refused(encoding: str) -> None:
    def read(body: bytes) -> None:
        decoder = decoder_of(encoding)
        assert decoder is not None
        for start in range(0, len(body), 1000):
            for _ in decoder.feed(body[start : start + 1000]):
                pass
        decoder.finish()

    attack(encoding, bodies(encoding, read))


def test_damaged_json_is_a_model_or_invalid() -> None:
    models: list[type[BaseModel]] = [PosesIn, MapIn, KeyIn]

    def read(body: bytes) -> None:
        for model in models:
            with suppress(ValidationError):
                found = model.model_validate_json(body)
                found.model_dump_json()
                if isinstance(found, PosesIn):
                    found.to_core()

    attack("json", bodies("json", read))


def test_a_damaged_packed_signature_is_a_signature_or_refused() -> None:
    whole = [
        pack_signatures(made.basis().encode(made.basis().image(Scan.from_returns(CLOUD))), packing)
        for made in (MAPS["paper"](), MAPS["harmonic"]())
        for packing in (None, Packing.FLOAT16)
    ]
    chance = chance_of("signatures")

    def inputs() -> Iterator[Callable[[], object]]:
        while True:
            body = damaged(chance.choice(whole), chance)
            yield lambda body=body: unpack_signatures(body)  # type: ignore[misc]

    attack("signatures", inputs())


# Not Ford's folders, which only commands read: SciPy's reader of `.mat` files may end the process.
@pytest.mark.parametrize("kind", ["capture", "kitti", "scans", "nclt", "mulran", "helipr"])
def test_a_damaged_drive_is_a_drive_or_refused(kind: str, tmp_path) -> None:
    chance = chance_of(kind)

    def inputs() -> Iterator[Callable[[], object]]:
        while True:
            path = _drive(kind, chance, tmp_path)
            yield lambda path=path: _read_drive(path)  # type: ignore[misc]

    attack(kind, inputs())


def _read_drive(path) -> None:
    drive = open_drive(path)
    with suppress(TensorMapError):
        assert len(drive.poses) == len(drive.timestamp_s) == len(drive)
    for index in range(min(len(drive), 3)):
        with suppress(TensorMapError):
            drive.scan(index)


_FOLDERS = {"kitti": "velodyne", "nclt": "velodyne_sync", "scans": "scans"}


def _drive(kind, chance, folder):
    if kind == "capture":
        path = folder / "a.pcap"
        path.write_bytes(damaged(chance.choice(WHOLE["velodyne"]), chance))
        return path
    if kind in {"mulran", "helipr"}:
        return _timed_drive(kind, chance, folder)
    scans = folder / _FOLDERS[kind]
    scans.mkdir(exist_ok=True)
    name = chance.choice(["kitti", "npy", "pcd", "ply", "csv"]) if kind == "scans" else kind
    suffix = {"kitti": ".bin", "nclt": ".bin"}.get(name, f".{name}")
    for index in range(2):
        (scans / f"{index}{suffix}").write_bytes(damaged(chance.choice(WHOLE[name]), chance))
    if kind == "scans":
        return scans
    if kind == "nclt":
        return folder
    line = b"1 0 0 1 0 1 0 2 0 0 1 3\n"
    for beside, body in (
        ("times.txt", b"0.0\n0.1\n"),
        ("poses.txt", line * 2),
        ("calib.txt", b"P0: 1\nTr: " + line),
    ):
        (folder / beside).write_bytes(body if chance.random() < 0.5 else damaged(body, chance))
    return folder


def _timed_drive(kind, chance, folder):
    """Scans named by nanoseconds, and poses at times around them."""
    scans, truth, name, rows = {
        "mulran": ("Ouster", "global_pose.csv", "kitti", b"%d,1,0,0,5,0,1,0,6,0,0,1,7\n"),
        "helipr": ("LiDAR/Avia", "LiDAR_GT/Avia_gt.txt", "helipr-avia", b"%d 5 6 7 0 0 0 1\n"),
    }[kind]
    for file in (folder / scans, (folder / truth).parent):
        file.mkdir(parents=True, exist_ok=True)
    for at_ns in (10**18, 10**18 + 10**8):
        body = damaged(chance.choice(WHOLE[name]), chance)
        (folder / scans / f"{at_ns}.bin").write_bytes(body)
    lines = b"".join(rows % (10**18 + step * 9 * 10**7) for step in range(-1, 3))
    (folder / truth).write_bytes(lines if chance.random() < 0.3 else damaged(lines, chance))
    return folder


MAPS = {
    "paper": lambda: sample_map(count=12, segment_length=4, drives=2)[0],
    "harmonic": lambda: sample_harmonic_map(count=12, segment_length=4, drives=2)[0],
    "calibrated": lambda: calibrated_map(count=40),
}
ODD_VALUES: list[Any] = [
    None, True, -1, 0, 1.5, 2**63, 10**400, -0.0, float("nan"), float("inf"), 1e308, "", "\ud800",
    "a" * 300, "\0", [], [[]], {}, {"a": 1}, ["a", "a"], "harmonic", "paper", [5, 5], [10**30, 2],
]  # fmt: skip


@pytest.mark.parametrize("kind", MAPS)
def test_odd_parts_are_a_map_that_can_be_answered_with_or_refused(kind: str) -> None:
    whole = MAPS[kind]()
    chance = chance_of(f"map {kind}")

    def inputs() -> Iterator[Callable[[], object]]:
        while True:
            arrays = dict(whole.arrays())
            attributes = dict(whole.attributes())
            for _ in range(chance.randint(1, 3)):
                if chance.random() < 0.5:
                    name = chance.choice(list(arrays))
                    arrays[name] = _odd_array(arrays[name], chance)
                else:
                    attributes = _odd_attributes(attributes, chance)
            yield lambda a=arrays, b=attributes: _answer_with(a, b)  # type: ignore[misc]

    attack(f"map {kind}", inputs())


def _odd_array(array: np.ndarray, chance: random.Random) -> np.ndarray:
    odd = np.array(array)
    if not odd.size or not odd.ndim:
        return np.array([7])
    match chance.randrange(9):
        case 0:
            return odd[: chance.randrange(len(odd) + 1)]
        case 1:
            return np.concatenate([odd, odd])
        case 2:
            return odd.reshape(-1)
        case 3:
            with warnings.catch_warnings(action="ignore"), suppress(ValueError):
                # Some texts, and NaN of some kinds, are no number of another.
                return odd.astype(chance.choice(["f8", "i8", "U8", "O", "c16", "?", "u8"]))
            return odd
        case 4:
            return np.zeros_like(odd)
        case 5:
            return np.array(7)
        case _:
            if odd.dtype.kind not in "cfi":
                return odd
            flat = odd.reshape(-1)
            numbers: list[float] = [0, 1, -1, 7, 2**31, 2**53, 2**62, -(2**63)]
            if odd.dtype.kind != "i":
                numbers += [np.nan, np.inf, -np.inf, 1e-320, 3e38]
            for _ in range(chance.randint(1, 4)):
                with warnings.catch_warnings(action="ignore"):
                    flat[chance.randrange(len(flat))] = np.array(chance.choice(numbers)).astype(
                        odd.dtype
                    )
            return odd


def _odd_attributes(attributes: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    odd = dict(attributes)
    name = chance.choice([*odd, "more"])
    if isinstance(odd.get(name), dict) and odd[name] and chance.random() < 0.8:
        odd[name] = _odd_attributes(odd[name], chance)
    elif isinstance(odd.get(name), list) and odd[name] and chance.random() < 0.6:
        odd[name] = list(odd[name])
        odd[name][chance.randrange(len(odd[name]))] = chance.choice(ODD_VALUES)
    elif chance.random() < 0.2:
        odd.pop(name, None)
    else:
        odd[name] = chance.choice(ODD_VALUES)
    return odd


def _answer_with(arrays: dict[str, Any], attributes: dict[str, Any]) -> None:
    made = TensorMap.from_parts(arrays, attributes)
    assert len(made.revision) == 64
    TopologyOut.from_core(made).model_dump_json().encode()
    BasisOut.from_core(made.basis()).model_dump_json().encode()
    for row in range(len(made)):
        Pose.from_row(made.trajectory.poses[row])
    if made.calibration is not None:
        for distance in (0.0, 1e-9, 1.0, 1e9):
            assert 0.0 < made.calibration.probability(distance, 0.5) < 1.0
    for node in range(len(made.topology.node_scan)):
        made.topology.segments_at(node)
