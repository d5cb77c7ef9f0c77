"""Stores to back up, and the members of backups."""

import io
import tarfile

import numpy as np

from core.scans.scan import Scan
from storage.catalog import RevisionFacts
from storage.files.map_file import write_map
from tests.support.samples import sample_map

FACTS = RevisionFacts(encoding="paper", scans=24, segments=3, parameters={})


def scan_of(seed):
    return Scan(np.random.default_rng(seed).normal(scale=10, size=(150, 3)).astype(np.float32))


def put(store, indices, drive="monday"):
    for index in indices:
        store.drives.put_scan("campus", drive, index, scan_of(index))


def add_revision(store):
    tensor_map, _ = sample_map()
    map_id = store.maps.get("campus").id
    return store.revisions.add(
        map_id, tensor_map.revision, lambda path: write_map(path, tensor_map), FACTS
    )


def members(path):
    with tarfile.open(path) as tar:
        found = []
        for member in tar:
            content = tar.extractfile(member)
            assert content is not None
            found.append((member, content.read()))
        return found


def rewrite(path, content):
    with tarfile.open(path, "w") as tar:
        for member, body in content:
            member.size = len(body)
            tar.addfile(member, io.BytesIO(body))
