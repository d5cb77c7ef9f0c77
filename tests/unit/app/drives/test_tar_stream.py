"""Tar streams: bounded headers, and one archive in each."""

import gzip
import io
import tarfile
import zipfile
from collections.abc import Callable

import pytest
import zstandard

from app.http.errors import MalformedUpload
from tests.support.recording import tar, tar_members


def headers_only(count: int) -> bytes:
    return tar([(f"{index}.bin", b"") for index in range(100)])[: 512 * 100] * (count // 100)


def test_a_tar_stream_of_headers_is_rejected_and_one_of_small_files_is_read() -> None:
    def files(body: bytes) -> int:
        return sum(1 for _ in tar_members(body, 2**20))

    assert files(headers_only(9_000)) == 9_000
    with pytest.raises(MalformedUpload, match="more than 10000 headers"):
        files(headers_only(10_100))
    small = tar([(f"{index}.bin", bytes(512)) for index in range(100)])[: 1024 * 100]
    assert files(small * 150) == 15_000


def test_extended_headers_that_follow_one_another_are_bounded() -> None:
    header = tar([("x", b"")])[:512]
    # The sum is of all bytes, blanks in place of the sum itself.
    pax = bytearray(header[:156] + b"x" + header[157:])
    pax[148:156] = b"%06o\0 " % sum(pax[:148] + b" " * 8 + pax[156:])
    with pytest.raises(MalformedUpload, match="more than 8 extended headers"):
        list(tar_members(bytes(pax) * 9 + header, 2**20))


def test_a_tar_stream_that_ends_after_a_long_name_is_incomplete() -> None:
    body = tar([("x", b"")])
    long_name = bytearray(body[:156] + b"L" + body[157:512])
    long_name[148:156] = b"%06o\0 " % sum(long_name[:148] + b" " * 8 + long_name[156:])
    whole = body[:512] + bytes(long_name)
    with pytest.raises(MalformedUpload, match="breaks off before the file of a long name"):
        list(tar_members(whole, 2**20))
    assert [member.name for member in tar_members(whole + body, 2**20)] == ["x", "x"]


def test_a_link_with_a_long_name_and_a_long_target_is_one_file() -> None:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.GNU_FORMAT) as archive:
        link = tarfile.TarInfo("a" * 150)
        link.type, link.linkname = tarfile.SYMTYPE, "b" * 150
        archive.addfile(link)
        archive.addfile(tarfile.TarInfo("1.bin"))
    names = [member.name for member in tar_members(packed.getvalue(), 2**20)]
    assert names == ["a" * 150, "1.bin"]


def test_archives_one_after_another_are_rejected_and_not_read_in_part() -> None:
    first, second = (tar([(name, bytes(600))]) for name in ("1.bin", "2.bin"))
    with pytest.raises(MalformedUpload, match="follow the end of the tar stream: wanted one"):
        list(tar_members(first + second, 2**20))
    padded = first + bytes(2**17)
    assert [member.name for member in tar_members(padded, 2**20)] == ["1.bin"]


def with_sum(header: bytes, sum_of: Callable[[bytes], int]) -> bytes:
    """Return a header with another checksum."""
    return header[:148] + b"%06o\0 " % sum_of(header[:148] + b" " * 8 + header[156:]) + header[156:]


@pytest.mark.parametrize("wrong", [-1, 1, 256, -256])
def test_a_header_with_a_wrong_checksum_is_rejected(wrong: int) -> None:
    body = tar([("1.bin", bytes(600))])
    changed = with_sum(body[:512], lambda header: sum(header) + wrong) + body[512:]
    with pytest.raises(MalformedUpload, match=r"begins with b'1\.bin.*its checksum is wrong"):
        list(tar_members(changed, 2**20))


def test_a_checksum_may_be_of_signed_bytes_as_some_programs_add_them() -> None:
    def signed(header: bytes) -> int:
        return sum(byte - 256 if byte > 127 else byte for byte in header)

    body = tar([("é/1.bin", bytes(600))])
    changed = with_sum(body[:512], signed) + body[512:]
    assert changed != body
    assert [member.name for member in tar_members(changed, 2**20)] == ["é/1.bin"]


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
def test_a_compressed_tar_is_rejected_with_the_header_that_it_wants(encoding: str) -> None:
    compress = {"gzip": gzip.compress, "zstd": zstandard.ZstdCompressor().compress}[encoding]
    body = compress(tar([("1.bin", bytes(range(256)) * 40)]))
    wanted = f"the body is {encoding}, wanted a tar stream: with 'Content-Encoding: {encoding}' it"
    with pytest.raises(MalformedUpload, match=wanted):
        list(tar_members(body + bytes(512), 2**20))


def test_a_zip_in_place_of_a_tar_stream_is_named() -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("1.bin", bytes(600))
    with pytest.raises(MalformedUpload, match="the body is zip, wanted a tar stream"):
        list(tar_members(packed.getvalue(), 2**20))
