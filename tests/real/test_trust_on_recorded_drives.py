"""Known places are separated from unknown ones on recorded drives."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from core.errors import InvalidScan
from core.evaluation.condition import Condition
from core.evaluation.evaluate import EvaluationProtocol, evaluate
from core.evaluation.split import Every
from core.localization.localizer import Localization, Localizer
from core.mapping.pipeline import build_map
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.projection.imager import Image
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from tests.support.maps_once import map_once
from tests.support.recorded_drives import Drives

pytestmark = pytest.mark.real_data


def test_scans_of_another_town_are_separated_from_those_of_the_map(drives: Drives) -> None:
    parameters = MapParameters.for_sensor(encoding="harmonic")
    found = evaluate(
        drives.open("kitti00"),
        EvaluationProtocol(parameters, segments=5, split=Every(2)),
        unknown=[drives.open("kit_muehlburger")],
        rendered=drives.rendered("kitti00", parameters),
    )
    of_it = found.conditions[0].reliability
    assert of_it is not None
    assert of_it.unknown_queries == 501
    assert of_it.auroc is not None
    assert of_it.auroc >= 0.98
    assert of_it.refused_right is not None
    assert of_it.refused_right <= 0.05
    assert of_it.refused_unknown is not None
    assert of_it.refused_unknown >= 0.95


@pytest.fixture(scope="module")
def localizer(drives: Drives, shared: Path) -> Localizer:
    """The map of the even scans of kitti00."""

    def build() -> TensorMap:
        drive = drives.open("kitti00")
        even = MemoryDrive("even", [drive.scan(i) for i in range(0, len(drive), 2)])
        return build_map(even, MapParameters.for_sensor())

    return Localizer(map_once(shared, "even", build))


def test_few_numbers_of_another_drive_find_no_place_and_those_of_the_map_theirs(
    drives: Drives, localizer: Localizer
) -> None:

    def images(name: str, first: int, step: int) -> list[tuple[int, Image]]:
        of = drives.open(name)
        return [(i, localizer.basis.image(of.scan(i))) for i in range(first, len(of), step)]

    known = images("kitti00", 1, 4)
    unknown = [
        image
        for name in ("nclt_turn", "kitti_drive0001", "kit_muehlburger")
        for _, image in images(name, 0, 7)
    ]
    for ranks in ((5, 5), (4, 4)):

        def found(image: Image, ranks: tuple[int, int] = ranks) -> Localization:
            return localizer.localize_signatures(localizer.basis.encode(image, ranks))

        assert sum(found(image).localized for image in unknown) <= 0.03 * len(unknown)
        answers = [(found(image), i) for i, image in known]
        right = [abs(2 * of.best.scan_index - i) <= 8 for of, i in answers if of.localized]
        assert all(right)
        assert len(right) >= 0.85 * len(answers)


def test_scans_of_little_of_a_view_find_hardly_a_place_in_the_map_of_another_drive(
    drives: Drives, localizer: Localizer
) -> None:
    drive, rng = drives.open("kitti00"), np.random.default_rng(3)

    def found(name: str, disturbance: str, first: int, step: int) -> list[tuple[int, Localization]]:
        of, condition = drives.open(name), Condition(disturb=disturbance)
        answers = []
        for i in range(first, len(of), step):
            with suppress(InvalidScan):  # nothing is left of a few
                scan = condition.apply(of.scan(i), rng)
                answers.append((i, localizer.localize_scan(scan)))
        return answers

    unknown = [
        answer.localized
        for name in ("nclt_turn", "kitti_drive0001", "kit_muehlburger")
        for disturbance in ("fov:90", "fov:60", "hidden:270", "hidden:300")
        for _, answer in found(name, disturbance, 0, 9)
    ]
    assert sum(unknown) <= 0.02 * len(unknown)
    for disturbance, least in (("", 0.98), ("fov:120", 0.9), ("fov:90", 0.75)):
        known = [(i, of) for i, of in found("kitti00", disturbance, 1, 4) if of.localized]
        right = [abs(2 * of.best.scan_index - i) <= 8 for i, of in known]
        assert all(right)
        assert len(right) >= least * len(range(1, len(drive), 4))


def test_a_scan_of_a_narrow_sensor_is_believed_as_far_as_its_signature_agrees(
    drives: Drives,
) -> None:
    condition = Condition(disturb="beams:16+fov:120")

    def seen(name: str, first: int, step: int) -> list[tuple[int, Scan]]:
        of, rng = drives.open(name), np.random.default_rng(0)
        return [(i, condition.apply(of.scan(i), rng)) for i in range(first, len(of), step)]

    even = MemoryDrive("even", [scan for _, scan in seen("kitti00", 0, 2)])
    localizer = Localizer(build_map(even, MapParameters.for_sensor()))
    known = [(i, localizer.localize_scan(scan)) for i, scan in seen("kitti00", 1, 4)]
    right = [of.localized and abs(2 * of.best.scan_index - i) <= 8 for i, of in known]
    unknown = [localizer.localize_scan(scan) for _, scan in seen("kit_muehlburger", 0, 8)]
    assert sum(right) >= 0.54 * len(right)  # by images alone 28 of 63, with signatures 38
    assert sum(of.localized for of in unknown) <= 0.02 * len(unknown)  # 2 of 63, with signatures 0
