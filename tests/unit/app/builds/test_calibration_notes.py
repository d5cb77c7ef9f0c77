"""Notes of a build on answers without a probability, or without standard deviations."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.builds.calibration_notes import calibration_notes

EXACT, ROUGH = SimpleNamespace(spread="some"), SimpleNamespace(spread=None)
NONE, HALF, ALL = np.zeros(8, bool), np.arange(8) % 2 == 0, np.ones(8, bool)


def notes_of(of_signatures, of_scans, known=ALL):
    of_map: Any = SimpleNamespace(
        calibration=of_signatures,
        calibration_of_scans=of_scans,
        trajectory=SimpleNamespace(known=known),
    )
    return list(calibration_notes(of_map))


@pytest.mark.parametrize(
    ("of_signatures", "of_scans", "wanted"),
    [
        (None, None, "every query is localized"),
        (None, EXACT, "every query by signature is localized"),
        (EXACT, None, "every query by scan or image is localized"),
    ],
)
def test_a_build_notes_which_queries_have_no_calibration(of_signatures, of_scans, wanted):
    [note] = notes_of(of_signatures, of_scans)
    assert wanted in note


@pytest.mark.parametrize(
    ("of_signatures", "of_scans", "wanted"),
    [
        (ROUGH, ROUGH, "no answer to a query has standard deviations"),
        (EXACT, ROUGH, "no answer to a query by scan or image has standard deviations"),
    ],
)
def test_a_build_notes_that_too_few_scans_have_poses_for_deviations(
    of_signatures, of_scans, wanted
):
    [note] = notes_of(of_signatures, of_scans, HALF)
    assert note.startswith("4 of 8 scans have a pose")
    assert wanted in note


def test_a_build_of_a_map_that_is_calibrated_as_its_poses_allow_notes_nothing_of_that():
    assert not notes_of(EXACT, EXACT, HALF)
    assert not notes_of(ROUGH, ROUGH, NONE)  # in scan indices: its drives have notes on that
