from dataclasses import replace

import numpy as np
import pytest

from core.encodings.harmonic.seen import Seen
from core.encodings.harmonics import as_real
from core.localization.localizer import Localizer
from core.mapping.pipeline import build
from core.parameters import MapParameters
from core.projection.rings import RingGrid
from core.projection.visibility import seen_of_bits
from core.scans.drive import MemoryDrive
from tests.support.recording import recording


@pytest.mark.parametrize(("columns", "r2"), [(360, 12), (360, 92), (360, 181), (36, 12), (60, 31)])
def test_what_is_seen_has_the_harmonics_of_its_columns_however_many(columns, r2):
    hidden = np.array([[0b111, 0], [1 << 59, 0b1010]])
    count = 2 * r2 - 1
    seen = Seen(hidden, columns, r2, 6, each=True)
    rows, renderings = np.array([0, 1, 0]), np.array([0, 1, 1])
    turns = np.outer(np.arange(columns), np.arange(count)) / columns
    wanted = seen_of_bits(hidden[rows, renderings], columns) @ np.exp(-2j * np.pi * turns) / columns
    found = seen.harmonics(rows, renderings, count)
    assert found == pytest.approx(as_real(wanted.T), abs=1e-6)


@pytest.mark.parametrize(
    ("ranks", "grid"),
    [((5, 92), RingGrid()), ((6, 7), RingGrid(azimuth_step_deg=10.0))],
    ids=["many harmonics", "few columns"],
)
def test_a_map_answers_whatever_harmonics_its_columns_have(ranks, grid):
    parameters = replace(MapParameters.for_sensor(ranks=ranks), grid=grid)
    scans = recording().scans
    block = MemoryDrive("block", scans[::4])
    tensor_map = build([block], parameters, calibrated=False).tensor_map
    assert tensor_map.arrays()["hidden_sectors"].any()
    localizer = Localizer(tensor_map)
    for row in (3, 8):
        image = localizer.basis.image(scans[4 * row + 1])
        assert localizer.localize_image(image).best.row == row
        assert localizer.localize_signatures(localizer.basis.encode(image)).best.row == row
