"""The application: what it imports, and its store."""

import logging
import re
import subprocess
import sys
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from app.localization.place_indexes import PlaceIndexes
from app.main import create_app
from app.settings import Settings
from storage.catalog.keys import Keys
from storage.errors import StorageFull
from storage.store import Store


def test_the_application_imports_no_library_that_few_services_need_until_one_does() -> None:
    # SciPy takes 45 MB and 0.3 s, and answers do without: import such ones where they are used.
    heavy = "{'scipy', 'kiss_icp', 'sqlalchemy.dialects.postgresql'}"
    program = f"import app.main, sys; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_a_store_that_is_open_is_not_opened_again_and_is_closed_at_the_end(tmp_path: Path) -> None:
    """Migrations and leftovers of many maps take a start's time, and a second lock would fail."""
    settings = Settings(data_dir=tmp_path / "data")
    store = Store.serving(settings.data_dir)
    app = create_app(settings, store)
    with TestClient(app) as client:
        assert client.get("/readyz").is_success
        assert app.state.service.store is store
    Store.serving(settings.data_dir).close()


@pytest.mark.parametrize("full", ["the output", "the catalog", "the tracks"])
def test_a_first_start_that_fails_does_not_take_the_key_with_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    full: str,
) -> None:
    settings = Settings(data_dir=tmp_path / "data", host="0.0.0.0")

    def fail(*_: object, **__: object) -> None:
        raise StorageFull("no space is left")

    with monkeypatch.context() as first:
        if full == "the output":
            first.setattr("builtins.print", fail)
        elif full == "the catalog":
            first.setattr(Keys, "add", fail)
        else:
            first.setattr(Store, "saved_tracks", fail)
        with pytest.raises(StorageFull), TestClient(create_app(settings)):
            pass
    with TestClient(create_app(settings)) as client:
        shown = re.findall(r"tm_\S+", capsys.readouterr().out)
        headers = {"Authorization": f"Bearer {shown[-1]}"}
        assert client.get("/v1/maps", headers=headers).is_success


def test_a_part_that_cannot_be_stopped_is_logged_and_the_others_are_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    app = create_app(Settings(data_dir=tmp_path / "data"))
    with TestClient(app), caplog.at_level(logging.ERROR, "tensormap"):
        service = app.state.service
        stop = service.runner.stop

        def stop_and_fail() -> None:
            stop()
            raise RuntimeError("the disk is gone")

        monkeypatch.setattr(service.runner, "stop", stop_and_fail)
        monkeypatch.setattr(service.tracks, "close", stop_and_fail)
    for part in (service.collector, service.scrub, service.indexes, service.track_saver):
        assert not part._thread.is_alive(), part
    Store.serving(tmp_path / "data").close()
    errors = [record for record in caplog.records if record.levelname == "ERROR"]
    assert ["builds" in errors[0].getMessage(), "tracks" in errors[1].getMessage()] == [True] * 2
    assert "the disk is gone" in caplog.text


def test_a_part_that_cannot_be_started_ends_the_others_and_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(PlaceIndexes, "start", refuse)
    app = create_app(Settings(data_dir=tmp_path / "data"))
    with pytest.raises(RuntimeError, match="can't start new thread"), TestClient(app):
        pass
    service = app.state.service
    for thread in (*service.runner._threads, service.collector._thread, service.scrub._thread):
        assert thread.ident is not None  # it ran
        assert not thread.is_alive(), thread
    Store.serving(tmp_path / "data").close()


def test_a_stop_ends_purges_under_any_server(tmp_path: Path) -> None:
    app = create_app(Settings(data_dir=tmp_path / "data"))
    with TestClient(app):
        purges = app.state.service.store.purges
        assert not purges._stopping.is_set()
    assert purges._stopping.is_set()
