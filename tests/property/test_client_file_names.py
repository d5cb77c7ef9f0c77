"""A client reads the times and the order of scan files in their names as the service does."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tensormap_client import FolderSource, InvalidArgument

from storage.formats.drives.kitti_drive import open_scan_folder
from storage.formats.errors import MalformedDrive

YEARS = st.sampled_from(["1989", "1990", "2023", "2100", "2101"])
DATES = st.from_regex(r"(0\d|1[0-3])([0-2]\d|3[0-2])([01]\d|2[0-4])[0-6]\d[0-6]\d", fullmatch=True)
STEMS = {
    "whole numbers": st.sampled_from([1, 6, 9, 10, 13, 16, 19, 20]).flatmap(
        lambda digits: st.integers(0, 10**digits - 1).map(lambda number: f"{number:0{digits}}")
    ),
    "fractions": st.from_regex(r"(a_)?(16790000)?[0-9]{1,2}\.[0-9]{1,9}", fullmatch=True),
    "few fractions": st.from_regex(r"[12]\.[05]0{0,8}", fullmatch=True),
    "dates": st.tuples(YEARS, DATES, st.sampled_from(["", "05", "123", "123456", "5"])).map(
        "".join
    ),
    "any": st.from_regex(r"[a-z]?_?[0-9]{1,4}[a-z]?", fullmatch=True),
}


@pytest.mark.parametrize("stems", STEMS.values(), ids=STEMS)
@settings(deadline=None, max_examples=50)
@given(st.data())
def test_files_are_sent_in_the_order_and_with_the_times_that_the_service_reads(stems, data):
    suffix = st.sampled_from([".bin", ".pcd.bin", ".pcd", ".npy", ".LAZ"])
    names = data.draw(st.lists(st.tuples(stems, suffix).map("".join), min_size=1, max_size=6))
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in names:
            (folder / name).write_bytes(name.encode())
        try:
            read = open_scan_folder(folder)
        except MalformedDrive:
            read = None
        try:
            sent = FolderSource(folder)
        except InvalidArgument:
            assert read is None
            return
        assert read is not None
        bodies = [sent.scan_body(at) for at in range(len(sent))]
        assert [body.body.decode() for body in bodies] == [file.name for file in read.files]
        times_s = [None if time_s != time_s else time_s for time_s in read.timestamp_s.tolist()]
        assert [body.timestamp_s for body in bodies] == times_s
