from functools import reduce
from operator import xor

import pytest

from storage.formats.errors import MalformedDrive
from storage.formats.tracks.nmea import is_nmea, read_nmea

MIDNIGHT_S = 1_795_478_400.0  # before 2026-11-24


def sentence(body):
    return f"${body}*{reduce(xor, body.encode(), 0):02X}"


def gga(time="120000.00", quality="4", altitude="115.5,M,48.0,M", latitude="4900.6000,N"):
    return sentence(f"GNGGA,{time},{latitude},00824.0000,E,{quality},12,0.8,{altitude},,")


def rmc(time="120000.00", date="231126", status="A"):
    return sentence(f"GPRMC,{time},{status},4900.6000,N,00824.0000,E,1.0,2.0,{date},,,A")


def read(tmp_path, *lines):
    file = tmp_path / "log.nmea"
    file.write_text("\r\n".join(lines) + "\r\n")
    return read_nmea(file)


def test_a_position_has_the_date_of_the_log_and_the_altitude_above_the_ellipsoid(tmp_path):
    fixes, notes = read(tmp_path, gga("115959.50"), rmc(), gga("120000.50"), "$GPGSV,1,1,00*79")
    assert not notes
    assert [fix["time_s"] for fix in fixes] == [MIDNIGHT_S - 43200.5, MIDNIGHT_S - 43199.5]
    assert fixes[0]["latitude_deg"] == pytest.approx(49.01)
    assert fixes[0]["longitude_deg"] == pytest.approx(8.4)
    assert fixes[0]["altitude_m"] == 163.5


def test_south_and_west_are_negative(tmp_path):
    body = "GPGGA,120000,4900.6,S,00824.0,W,1,12,0.8,,,,,,"
    ((fix,), _) = read(tmp_path, rmc(), sentence(body))
    assert fix["latitude_deg"] == pytest.approx(-49.01)
    assert fix["longitude_deg"] == pytest.approx(-8.4)
    assert "altitude_m" not in fix


def test_the_date_changes_at_midnight(tmp_path):
    fixes, _ = read(tmp_path, rmc("235959.00"), gga("235959.50"), gga("000000.50"))
    assert [fix["time_s"] - MIDNIGHT_S for fix in fixes] == [-0.5, 0.5]


def test_a_log_without_gga_has_the_positions_of_rmc(tmp_path):
    fixes, _ = read(tmp_path, rmc("120000.00"), rmc("120001.00"))
    assert [fix["time_s"] - MIDNIGHT_S for fix in fixes] == [-43200, -43199]


def test_sentences_without_a_position_are_left_out(tmp_path):
    fixes, notes = read(tmp_path, rmc(), gga(quality="0"), rmc(status="V"), gga("120001.00"))
    assert len(fixes) == 1
    assert not notes
    with pytest.raises(MalformedDrive, match="has no position"):
        read(tmp_path, rmc(status="V"), gga(quality="0"))


@pytest.mark.parametrize("quality", ["1", "6"])  # 6 is dead reckoning
def test_a_sentence_that_a_starting_receiver_leaves_empty_does_not_end_the_log(tmp_path, quality):
    lines = [
        sentence(f"GPGGA,120000.00,,,,,{quality},00,,,M,,M,,"),
        gga(time="", quality=quality),
        rmc(date=""),
        rmc(time=""),
        sentence("GPRMC,120000.00,A,,,,,,,231126,,,A"),
        rmc("120001.00"),
        gga("120001.50"),
    ]
    fixes, notes = read(tmp_path, *lines)
    assert [fix["time_s"] - MIDNIGHT_S for fix in fixes] == [-43198.5]
    assert not notes
    with pytest.raises(MalformedDrive, match="no RMC sentence with one and a date"):
        read(tmp_path, *lines[:5])
    with pytest.raises(MalformedDrive, match="no RMC sentence with a date"):
        read(tmp_path, *lines[:5], gga())


def test_a_damaged_sentence_is_left_out_and_named(tmp_path):
    wrong = gga("120000.20").replace("4900", "4800")
    fixes, notes = read(tmp_path, rmc(), gga(), wrong, gga()[:30], gga("120001.00"))
    assert len(fixes) == 2
    assert notes == [
        "log.nmea: 2 damaged sentences were left out; the first: line 3: the checksum is"
        f" {wrong[-2:]}, wanted {int(wrong[-2:], 16) ^ ord('9') ^ ord('8'):02X}"
    ]


def test_a_log_that_is_mostly_damaged_is_refused_with_the_first_line(tmp_path):
    with pytest.raises(MalformedDrive, match="line 2: it has no checksum"):
        read(tmp_path, rmc(), gga()[:-3], gga()[:-3])


@pytest.mark.parametrize(
    ("lines", "wanted"),
    [
        ([gga()], "no RMC sentence with a date"),
        ([rmc(date="321326")], "line 1: the date is '321326'"),
        ([rmc(), gga(time="noon")], "line 2: the time is 'noon'"),
        ([rmc(), gga(latitude="9900.0,N")], "line 2: the latitude is '9900.0'"),
        ([rmc(), gga(latitude="4900.0,X")], "line 2: the latitude is '4900.0' 'X'"),
        ([rmc(), gga(altitude="high,M,48.0,M")], "line 2: the altitude is 'high' and '48.0'"),
        ([rmc(), gga(altitude="nan,M,48.0,M")], "line 2: the altitude is 'nan' and '48.0'"),
        ([rmc(), gga(altitude="115.5,M,inf,M")], "line 2: the altitude is '115.5' and 'inf'"),
        ([rmc(), sentence("GPGGA,120000")], "line 2: GGA has 1 fields"),
        (["hello"], "no GGA sentence with one, and no RMC"),
    ],
)
def test_an_unusable_log_is_refused_with_its_line(tmp_path, lines, wanted):
    with pytest.raises(MalformedDrive, match=wanted) as refused:
        read(tmp_path, *lines)
    assert "log.nmea" in str(refused.value)


def test_a_log_is_known_by_its_sentences():
    assert is_nmea(f"ttyUSB0\n{gga()}\n")
    assert not is_nmea("time_s,latitude_deg,longitude_deg\n")
