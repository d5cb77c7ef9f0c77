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
        ("a.csv", "time_s,latitude_deg\n1,49\n", "it has the columns time_s, latitude_deg; wanted"),
        ("a.csv", "t;lat;lon\n1;49;8\n", "it has the columns t;lat;lon; wanted"),
        ("a.csv", "time_s,latitude_deg,longitude_deg\n1,,8.4\n", "fix 1 is {'time_s': 1.0, 'long"),
        ("a.csv", "time_s,latitude_deg,longitude_deg\n1,north,8.4\n", "line 2: could not"),
        ("a.csv", "", "has no fixes"),
        ("a.txt", "hello\n", "has no fixes; wanted GPX, NMEA .GGA, RMC., or the columns time_s"),
        ("a.csv", "time_s,latitude_deg,longitude_deg\nnan,49,8.4\n", "fix 1 has time_s nan"),
        (
            "a.json",
            '[{"time_s": 1, "latitude_deg": 49, "longitude_deg": 8.4, "altitude_m": 1e999}]',
            "fix 1 has altitude_m inf, wanted a finite number",
        ),
        ("a.json", "{}", "has no fixes"),
        ("a.json", "[", "the columns time_s, latitude_deg, longitude_deg"),
    ],
)
def test_what_is_no_track_is_refused_with_what_is_wanted(tmp_path, name, text, wanted):
    (tmp_path / name).write_text(text)
    with pytest.raises(CommandFailed, match=wanted):
        read_fixes(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "beginning", "wanted"),
    [
        ("a.csv", 'time_s,"', "field larger than field limit .131072.; wanted GPX"),
        ("a.json", "", "it is nested too deep; wanted GPX"),
    ],
)
def test_a_file_that_its_reader_gives_up_is_refused_likewise(tmp_path, name, beginning, wanted):
    (tmp_path / name).write_text(beginning + "[" * 200_000)
    with pytest.raises(CommandFailed, match=wanted):
        read_fixes(tmp_path / name)


def test_gpx_and_nmea_are_known_by_suffix_and_by_content(tmp_path, capsys):
    gpx = tmp_path / "a.GPX"
    gpx.write_text(
        '<gpx><trk><trkseg><trkpt lat="49" lon="8.4"><time>1970-01-01T00:00:01Z</time></trkpt>'
        "</trkseg></trk></gpx>"
    )
    assert read_fixes(gpx) == [FIX]
    log = tmp_path / "a.txt"
    log.write_text(
        "$GPRMC,000001,A,4900.0,N,00824.0,E,,,010100,,,A*72\n$GPGGA,000002\n"
        "$GPRMC,000002,A,4900.0,N,00824.0,E,,,010100,,,A*71\n"
    )
    assert len(read_fixes(log)) == 2
    assert "1 damaged sentence was left out; the first: line 2" in capsys.readouterr().out
