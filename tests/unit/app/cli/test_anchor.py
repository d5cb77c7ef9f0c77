import json

import pytest

from app.cli.anchor import read_fixes
from app.cli.errors import CommandFailed

FIX = {"time_s": 1.0, "latitude_deg": 49.0, "longitude_deg": 8.4}


def test_fixes_are_read_from_csv_and_from_json(tmp_path):
    table = tmp_path / "track.csv"
    table.write_text("latitude_deg,time_s,longitude_deg,accuracy_m,satellites\n49,1,8.4,,12\n")
    assert read_fixes(table) == [FIX]
    listed = tmp_path / "track.json"
    listed.write_text(json.dumps([FIX]))
    assert read_fixes(listed) == [FIX]


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("a.csv", "time_s,latitude_deg\n1,49\n", "fix 1 is {'time_s': 1.0, 'latitude_deg': 49.0}"),
        ("a.csv", "time_s,latitude_deg,longitude_deg\n1,north,8.4\n", "could not convert"),
        ("a.csv", "", "has no fixes"),
        ("a.json", "{}", "has no fixes"),
        ("a.json", "[", "wanted time_s, latitude_deg, longitude_deg"),
    ],
)
def test_what_is_no_track_is_refused_with_what_is_wanted(tmp_path, name, text, wanted):
    (tmp_path / name).write_text(text)
    with pytest.raises(CommandFailed, match=wanted):
        read_fixes(tmp_path / name)
