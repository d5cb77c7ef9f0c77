"""`tensormap demo`: how it ends where its service fails."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

from tensormap_client.problems import StorageFull

from app.cli.demo import _comment
from app.demo.outcome import Fixes
from tests.support.commands import called


@contextmanager
def _no_server(*_: object) -> Iterator[SimpleNamespace]:
    yield SimpleNamespace(url="http://127.0.0.1:9")


def test_a_full_disk_is_named_as_that_of_the_temporary_folder(monkeypatch, tmp_path) -> None:
    def full(*_: object) -> None:
        raise StorageFull("PUT /v1/x: 507 storage-full: raise the quota", 507, "storage-full", "")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("app.demo.server.running_server", _no_server)
    monkeypatch.setattr("app.demo.run.run_demo", full)
    shown = called("demo", "--once", status=1)
    assert f"raise the quota; it is the disk of {tmp_path}/tensormap-demo-" in shown
    assert shown.endswith(": TMPDIR names a folder on another one\n")
    assert not list(tmp_path.iterdir())


def test_an_unknown_encoding_is_refused_before_anything_is_started(monkeypatch) -> None:
    started: list[object] = []
    monkeypatch.setattr("app.demo.server.running_server", started.append)
    shown = called("demo", "--once", "--encoding", "foo", status=1)
    assert shown == "tensormap: encoding is 'foo', wanted paper, harmonic\n"
    assert not started


def _fixes(request: str, position_error_m: float | None, segment_accuracy: float = 1.0) -> Fixes:
    return Fixes(request, 60, segment_accuracy, 1.0, position_error_m, 94.0, 10.0)


def test_why_signatures_give_better_positions_than_scans_here_is_said_where_they_do() -> None:
    scan, signature = _fixes("full scan", 0.29), _fixes("signature, int8", 0.07)
    assert "exactly on the mapped line" in _comment([scan, signature], simulated=True)
    assert "Wrong segments" not in _comment([scan, signature], simulated=True)
    off = _fixes("full scan", 0.29, segment_accuracy=0.967)
    assert "Wrong segments" in _comment([off, signature], simulated=True)
    assert _comment([scan, signature], simulated=False) == ""
    assert _comment([_fixes("full scan", 0.05), signature], simulated=True) == ""
    assert _comment([_fixes("full scan", None), signature], simulated=True) == ""
