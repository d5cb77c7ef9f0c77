"""HDF5 files made to hurt whoever opens them: what the format allows, or almost allows."""

import io
import json
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from tests.torture.support.bodies import map_file

_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def hostile_maps() -> dict[str, bytes]:
    """Return files by their names, all of which claim to be maps."""
    changed = {name: _changed(change) for name, change in _CHANGES.items()}
    return {**changed, **dict(_patched())}


def truncated_maps(step: int) -> Iterator[bytes]:
    """Yield a map cut off at every `step`-th length."""
    _, sound = map_file()
    for length in range(0, len(sound), step):
        yield sound[:length]


def _changed(change: Callable[[h5py.File], object]) -> bytes:
    _, sound = map_file()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "map.h5")
        path.write_bytes(sound)
        with h5py.File(path, "r+") as file:
            change(file)
        return path.read_bytes()


def _replace(file: h5py.File, **options: object) -> None:
    del file["signatures"]
    file.create_dataset("signatures", **options)


def _external_link(file: h5py.File) -> None:
    del file["signatures"]
    file["signatures"] = h5py.ExternalLink("/etc/passwd", "/")


def _soft_links_in_a_circle(file: h5py.File) -> None:
    del file["signatures"]
    file["signatures"] = h5py.SoftLink("/relay")
    file["relay"] = h5py.SoftLink("/signatures")


def _group_in_itself(file: h5py.File) -> None:
    del file["signatures"]
    file["signatures"] = file["/"]


def _external_storage(file: h5py.File) -> None:
    _replace(file, shape=(24, 3, 4), dtype="<f4", external=[("/dev/zero", 0, 24 * 48)])


def _virtual(file: h5py.File) -> None:
    del file["signatures"]
    layout = h5py.VirtualLayout((24, 3, 4), "<f4")
    layout[:] = h5py.VirtualSource("/etc/passwd", "x", shape=(24, 3, 4))
    file.create_virtual_dataset("signatures", layout)


def _virtual_in_a_circle(file: h5py.File) -> None:
    del file["signatures"]
    layout = h5py.VirtualLayout((24, 3, 4), "<f4")
    layout[:] = h5py.VirtualSource(".", "signatures", shape=(24, 3, 4))
    file.create_virtual_dataset("signatures", layout)


def _deep(file: h5py.File) -> None:
    group = file
    for _ in range(3_000):
        group = group.create_group("g")


def _wide(file: h5py.File) -> None:
    for number in range(3_000):
        file.create_group(f"g{number}")


def _many_attributes(file: h5py.File) -> None:
    for number in range(3_000):
        file.attrs[f"a{number}"] = number


def _long_attribute(file: h5py.File) -> None:
    file.attrs["attributes"] = "[" * 60_000


def _nested_json(file: h5py.File) -> None:
    attributes = json.loads(file.attrs["attributes"])
    nested: object = 0
    for _ in range(500):
        nested = {"n": nested}
    file.attrs["attributes"] = json.dumps({**attributes, "provenance": nested})


def _surrogates(file: h5py.File) -> None:
    text = json.dumps(json.loads(file.attrs["attributes"]))
    file.attrs["attributes"] = text.replace("drive-0", "\\ud800")


def _nul_and_controls(file: h5py.File) -> None:
    text = json.dumps(json.loads(file.attrs["attributes"]))
    file.attrs["attributes"] = text.replace("drive-0", "\\u0000\\u001b[2J\\u202e")


def _infinite_numbers(file: h5py.File) -> None:
    file["pose"][...] = np.inf


_CHANGES: dict[str, Callable[[h5py.File], object]] = {
    "external link": _external_link,
    "soft links in a circle": _soft_links_in_a_circle,
    "a group in itself": _group_in_itself,
    "external storage": _external_storage,
    "virtual dataset": _virtual,
    "virtual dataset of itself": _virtual_in_a_circle,
    "deep groups": _deep,
    "wide group": _wide,
    "many attributes": _many_attributes,
    "long attribute": _long_attribute,
    "nested JSON": _nested_json,
    "lone surrogate": _surrogates,
    "control characters": _nul_and_controls,
    "infinite poses": _infinite_numbers,
    "huge chunked": lambda f: _replace(f, shape=(2**40, 3, 4), dtype="<f4", chunks=(1, 3, 4)),
    "huge contiguous": lambda f: _replace(f, shape=(2**40, 3, 4), dtype="<f4"),
    "gzip bomb": lambda f: _replace(
        f, data=np.zeros((2**22, 3, 4), "<f4"), chunks=(2**19, 3, 4), compression=9
    ),
    "unlimited": lambda f: _replace(
        f, shape=(24, 3, 4), maxshape=(None, 3, 4), dtype="<f4", chunks=True
    ),
    "text for numbers": lambda f: _replace(f, data=["x" * 99] * 24, dtype=h5py.string_dtype()),
    "references": lambda f: _replace(f, shape=(24,), dtype=h5py.ref_dtype),
    "rows of any length": lambda f: _replace(f, shape=(24,), dtype=h5py.vlen_dtype("<f4")),
    "wide records": lambda f: _replace(
        f, shape=(24,), dtype=[(f"f{i}", "<f8", (9,)) for i in range(200)]
    ),
    "big-endian": lambda f: _replace(f, data=np.zeros((24, 3, 4), ">f4")),
    "empty space": lambda f: _replace(f, data=h5py.Empty("<f4")),
    "32 dimensions": lambda f: _replace(f, shape=(1,) * 32, dtype="<f4"),
}


def _patched() -> Iterator[tuple[str, bytes]]:
    """Yield files whose bytes h5py would not write."""
    _, sound = map_file()
    for name, mark in (("B-tree", b"TREE"), ("heap", b"HEAP"), ("global heap", b"GCOL"),
                       ("symbol table", b"SNOD"), ("object header", b"OHDR"),
                       ("continuation", b"OCHK")):  # fmt: skip
        for at in _places(sound, mark):
            for field in range(4, 33, 4):
                for value in (0, 1, at, 2**32 - 1, 2**63 - 1, 2**64 - 1):
                    changed = bytearray(sound)
                    struct.pack_into("<Q", changed, min(at + field, len(changed) - 8), value)
                    yield f"{name} at {at}, byte {field} = {value:#x}", bytes(changed)
    yield "two signatures", _SIGNATURE + sound
    yield "a user block", bytes(512) + sound
    yield "a user block of nothing", bytes(2**20) + _SIGNATURE
    yield "only a signature", _SIGNATURE
    yield "nothing but zeros", bytes(100_000)
    with suppress(ValueError, OSError):
        yield "earliest format", _plain(libver="earliest")
    yield "latest format", _plain(libver="latest")


def _places(content: bytes, mark: bytes) -> Iterator[int]:
    at = content.find(mark)
    while at >= 0:
        yield at
        at = content.find(mark, at + 1)


def _plain(libver: str) -> bytes:
    """Return the same map as another version of the library lays it out."""
    _, sound = map_file()
    file = io.BytesIO()
    with h5py.File(io.BytesIO(sound)) as source, h5py.File(file, "w", libver=libver) as target:
        for name in source:
            source.copy(name, target)
        for name, value in source.attrs.items():
            target.attrs[name] = value
    return file.getvalue()
