"""Keys in files."""

from pathlib import Path

import pytest

from app.access.secrets import new_secret
from app.cli.errors import CommandFailed
from app.cli.service_options import read_key


@pytest.mark.parametrize(
    ("body", "got"),
    [
        (b"", "it is empty"),
        (b" \n", "it is empty"),
        ("schlüssel".encode(), "it has other characters"),
        (b"one\ntwo\n", "it has other characters"),
        ("key".encode("utf-16"), "it has other characters"),
    ],
)
def test_a_file_without_a_key_is_named(tmp_path, body, got):
    path = tmp_path / "the.key"
    path.write_bytes(body)
    with pytest.raises(CommandFailed, match=rf"the\.key: {got}, wanted one key"):
        read_key(path)


def test_a_key_may_have_a_mark_of_its_encoding_before_it_and_a_line_end_after_it(tmp_path):
    path = tmp_path / "the.key"
    path.write_bytes(b"\xef\xbb\xbftm_0a1b_secret\r\n")
    assert read_key(path) == "tm_0a1b_secret"


def test_a_key_in_place_of_its_file_is_not_repeated_in_the_error():
    key = new_secret().text
    with pytest.raises(CommandFailed, match="wanted the name of a file") as caught:
        read_key(Path(key))
    assert key not in str(caught.value)
