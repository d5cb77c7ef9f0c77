"""Notes on drives whose ground is far from where the mounting has it."""

import pytest

from app.builds.mounting_notes import mounting_notes
from core.scans.drive import MemoryDrive
from core.scans.mounting import Mounting
from tests.support.recording import recording

HEIGHT_M = 1.73
LEVEL = MemoryDrive("monday", recording().scans)


def notes(mounting, height_m=HEIGHT_M):
    return list(mounting_notes([(LEVEL, mounting)], height_m))


@pytest.mark.parametrize("mounting", [None, Mounting(1.0, 0.0, HEIGHT_M, yaw_deg=90.0)])
def test_a_drive_whose_ground_is_where_its_mounting_has_it_gets_no_note(mounting):
    assert notes(mounting) == []


@pytest.mark.parametrize(
    ("mounting", "height_m", "text", "mend"),
    [
        (None, 5.0, "the sensor is 1.7 m above the ground, not 5 m", "sensor_height_m"),
        (
            Mounting(0.0, 0.0, 6.0),
            HEIGHT_M,
            "the sensor is 1.7 m above the ground, not 6 m",
            "z_m of its mounting",
        ),
        (
            Mounting(0.0, 0.0, HEIGHT_M, pitch_deg=25.0),
            HEIGHT_M,
            "the ground is tilted by 25 degrees from where the mounting has it",
            "roll_deg, pitch_deg of its mounting",
        ),
        (
            Mounting(0.0, 0.0, 6.0, pitch_deg=25.0),
            HEIGHT_M,
            "the ground is tilted by 25 degrees from where the mounting has it and the sensor is"
            " 1.7 m above the ground, not 6 m",
            "roll_deg, pitch_deg, z_m of its mounting",
        ),
    ],
)
def test_a_ground_elsewhere_is_noted_with_where_and_what_to_correct(mounting, height_m, text, mend):
    [note] = notes(mounting, height_m)
    assert note == (
        f"drive monday: {text}, in 10 of 10 scans: correct {mend} and build again, and query"
        " likewise"
    )
