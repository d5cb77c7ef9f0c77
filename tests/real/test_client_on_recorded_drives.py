"""The client's signatures of recorded scans are the service's, in maps of every kind."""

import numpy as np
import pytest

from core.encodings.signature import pack_signatures
from core.scans.scan import Scan
from tests.support.client_bases import PARAMETERS, as_downloaded, basis_of

EVERY = 10


@pytest.mark.real_data
@pytest.mark.parametrize("name", PARAMETERS)
def test_its_bytes_are_the_services_on_kitti(drives, name: str) -> None:
    basis = basis_of(PARAMETERS[name])
    client = as_downloaded(basis)
    files = sorted((drives.path("kitti00") / "velodyne").glob("*.bin"))
    assert len(files) > EVERY
    for file in files[::EVERY]:
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        theirs = pack_signatures(basis.encode(basis.image(Scan.from_returns(rows[:, :3]))))
        assert client.encode(rows) == theirs, file.name
