"""Which stored drives are those of a map from a file."""

import math
from dataclasses import replace

import pytest

from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.builds.recall import drives_stored_here
from app.builds.revision_build import build_revision
from tests.support.recording import recording

SCANS = 8


@pytest.mark.parametrize("timed", [True, False])
def test_drives_without_times_are_known_by_their_poses(store, timed):
    map_id = store.maps.get("campus").id
    scans = [
        scan if timed else replace(scan, timestamp_s=math.nan) for scan in recording().scans[:SCANS]
    ]
    store.drives.put_scans("campus", "monday", list(enumerate(scans)))
    parameters = BuildParameters(segments=2)
    built = build_revision(store, map_id, plan_build(store, map_id, parameters))
    tensor_map = store.revisions.read(built)
    assert drives_stored_here(store, map_id, tensor_map) == built.drive_ids
    poses = tensor_map.trajectory.poses.copy()
    poses[:, 0] += 1.0
    moved = replace(tensor_map, trajectory=replace(tensor_map.trajectory, poses=poses))
    assert bool(drives_stored_here(store, map_id, moved)) == timed
