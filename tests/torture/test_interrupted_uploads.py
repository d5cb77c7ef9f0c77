"""`tensormap upload` of a folder of scans and of a bag, killed and repeated."""

import signal
import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.support.bags import cloud, record_bag
from tests.support.commands import PROGRAM, ROOT, tensormap
from tests.support.counted import counting
from tests.support.process import serving, until


def _folder(folder: Path) -> tuple[Path, int]:
    scans, returns = 200, 1000
    (folder / "velodyne").mkdir(parents=True)
    noise = np.random.default_rng(0)
    for index in range(scans):
        rows = np.abs(noise.normal(scale=20, size=(returns, 4))).astype("<f4")
        (folder / "velodyne" / f"{index:06}.bin").write_bytes(rows.tobytes())
    poses = [f"1 0 0 {index} 0 1 0 0 0 0 1 0\n" for index in range(scans)]
    (folder / "poses.txt").write_text("".join(poses))
    (folder / "times.txt").write_text("".join(f"{index / 10}\n" for index in range(scans)))
    return folder, scans


def _bag(folder: Path) -> tuple[Path, int]:
    clouds = [
        np.random.default_rng(seed).normal(0, 9, (150_000, 3)).astype("<f4") for seed in range(4)
    ]
    return record_bag(folder, map(cloud, clouds)), len(clouds)


@pytest.mark.parametrize(("record", "with_poses"), [(_folder, True), (_bag, False)])
def test_killed_three_times_it_sends_at_most_a_twentieth_more(record, with_poses, tmp_path):
    recording, scans = record(tmp_path / "recorded")
    wanted = [f"{scans} of {scans} scans stored"]
    if with_poses:
        wanted.append(f"{scans} of {scans} have a pose")
    with serving(tmp_path / "data", tmp_path / "log") as server:
        with counting(server.port) as whole:
            words = ["--map", "campus", "--drive", "whole", "--create"]
            shown = tensormap("upload", recording, whole.url, *words)
            assert all(part in shown for part in wanted)
        words[3] = "killed"
        with counting(server.port) as counted:
            for part in (1, 2, 3):
                # A fast upload would be over before it is killed.
                counted.hold_at(part * whole.sent_bytes // 4)
                client = subprocess.Popen(
                    [*PROGRAM, "upload", str(recording), counted.url, *words],
                    cwd=ROOT,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
                reached = partial(counted.reached, part * whole.sent_bytes // 4)
                until(reached, "it sends nothing")
                client.send_signal(signal.SIGKILL)
                assert client.wait(30) == -signal.SIGKILL
                counted.drop_held()
            shown = tensormap("upload", recording, counted.url, *words)
        assert wanted[-1] in shown
        assert counted.sent_bytes <= 1.05 * whole.sent_bytes
        drives = "/v1/maps/campus/drives"
        killed, undisturbed = (
            server.client.get(f"{drives}/{name}").json() for name in ("killed", "whole")
        )
        assert killed["present"] == undisturbed["present"] == [{"first": 0, "last": scans - 1}]
        assert killed["returns"] == undisturbed["returns"]
