import pytest

from storage.formats.errors import MalformedDrive
from storage.formats.tracks.gpx import read_gpx

GPX = """<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="logger" xmlns="http://www.topografix.com/GPX/1/1">
<wpt lat="1" lon="2"><name>no part of the track</name></wpt>
<trk><trkseg>
{points}
</trkseg></trk></gpx>
"""
POINT = '<trkpt lat="49.01" lon="8.4"><ele>115.5</ele><time>2026-11-23T12:00:00.5Z</time></trkpt>'
NOON_S = 1_795_435_200.0


def write(tmp_path, points, whole=GPX):
    file = tmp_path / "drive.gpx"
    file.write_text(whole.replace("{points}", points))
    return file


def test_points_of_tracks_become_fixes_at_seconds_since_1970(tmp_path):
    file = write(tmp_path, f"{POINT}</trkseg><trkseg>{POINT.replace('00:00.5Z', '00:01')}")
    assert read_gpx(file) == [
        {"time_s": NOON_S + 0.5, "latitude_deg": 49.01, "longitude_deg": 8.4},
        {"time_s": NOON_S + 1.0, "latitude_deg": 49.01, "longitude_deg": 8.4},
    ]


def test_a_time_in_a_zone_is_converted(tmp_path):
    (fix,) = read_gpx(write(tmp_path, POINT.replace("12:00:00.5Z", "14:00:00+02:00")))
    assert fix["time_s"] == NOON_S


def test_an_elevation_is_above_the_sea_and_used_only_with_the_height_of_the_geoid(tmp_path):
    with_geoid = POINT.replace("</time>", "</time><geoidheight>48</geoidheight>")
    (fix,) = read_gpx(write(tmp_path, with_geoid))
    assert fix["altitude_m"] == 163.5


@pytest.mark.parametrize(
    ("points", "wanted"),
    [
        ("", "has no point of a track with a time"),
        (f"{POINT}\n<trkpt lat='49.01' lon='8.4'></trkpt>", "line 6: the point has no <time>"),
        (POINT.replace('lon="8.4"', ""), "line 5: the point has no lon"),
        (POINT.replace('"49.01"', '"north"'), "line 5: lat is 'north'"),
        (POINT.replace('"49.01"', '"4_9"'), "line 5: lat is '4_9'"),
        (POINT.replace('"49.01"', '"nan"'), "line 5: lat is 'nan'"),
        (POINT.replace('"49.01"', '"91"'), "line 5: lat is '91'"),
        (POINT.replace("2026-11-23", "yesterday "), "line 5: the time is 'yesterday T12"),
        ("<trkpt", "line 6: not well-formed"),
    ],
)
def test_an_unusable_track_is_refused_with_its_line(tmp_path, points, wanted):
    with pytest.raises(MalformedDrive, match=wanted) as refused:
        read_gpx(write(tmp_path, points))
    assert "drive.gpx" in str(refused.value)


def test_a_document_type_is_refused_so_that_no_entity_is_expanded(tmp_path):
    bomb = '<!DOCTYPE gpx [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>\n<gpx>&b;</gpx>'
    with pytest.raises(MalformedDrive, match="line 1: it declares a document type"):
        read_gpx(write(tmp_path, "", bomb))


def test_a_cut_file_is_refused(tmp_path):
    with pytest.raises(MalformedDrive, match="unclosed token"):
        read_gpx(write(tmp_path, "", GPX[:60]))


@pytest.mark.parametrize("encoding", ["gb2312", "shift_jis", "utf-7", "no-such-1", "hex"])
def test_an_encoding_that_the_parser_does_not_read_is_refused_with_its_name(tmp_path, encoding):
    whole = GPX.replace("UTF-8", encoding)
    with pytest.raises(MalformedDrive, match=r"drive.gpx, line \d+: .*encoding.* wanted UTF-8"):
        read_gpx(write(tmp_path, POINT, whole))


@pytest.mark.parametrize("encoding", ["iso-8859-15", "windows-1252", "utf-16"])
def test_an_encoding_of_a_byte_a_character_is_read(tmp_path, encoding):
    file = tmp_path / "drive.gpx"
    whole = GPX.replace("UTF-8", encoding).replace("{points}", POINT).replace("logger", "Gerät")
    file.write_bytes(whole.encode(encoding))
    assert len(read_gpx(file)) == 1


def test_another_document_is_no_gpx(tmp_path):
    with pytest.raises(MalformedDrive, match="line 1: it begins with <kml>, wanted <gpx>"):
        read_gpx(write(tmp_path, "", "<kml></kml>"))
