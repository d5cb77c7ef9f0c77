import numpy as np

from core.encodings.signature import Signature
from core.localization.localizer import Localizer
from core.mapping.pipeline import build_map
from core.parameters import MapParameters
from core.scans.drive import MemoryDrive
from tests.support.recording import recording


def test_signatures_of_more_harmonics_than_are_trusted_find_their_places():
    scans = recording().scans
    parameters = MapParameters.for_sensor(ranks=(5, 100))
    localizer = Localizer(build_map(MemoryDrive("block", scans[::4]), parameters))
    nothing = Signature(np.zeros((5, 100), np.complex64), None, localizer.basis.digest)
    assert localizer.localize_signatures([nothing]).best.distance > 0.4
    for at in (9, 11, 13, 15, 17, 19):
        signatures = localizer.basis.encode(localizer.basis.image(scans[at]))
        assert abs(localizer.localize_signatures(signatures).best.row - at / 4) <= 0.5
