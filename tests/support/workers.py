"""Processes of builds that do not build; each one imports this file, and nothing else of tests."""

import os
import signal
import time
from pathlib import Path
from typing import Any


def never_end(*_: object) -> None:
    """Be a worker that never ends."""
    time.sleep(600)


def fall_over(*_: object) -> None:
    """Be a worker with a fault."""
    os._exit(3)


def be_killed_while_it_writes_images(*arguments: Any) -> None:
    """Be a worker that the system ends when it has begun to write a drive's images."""
    from app.jobs import worker
    from storage.files import image_file

    vars(image_file)["_write"] = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
    worker.run_job(*arguments)


def be_killed_while_it_writes_its_revision(*arguments: Any) -> None:
    """Be a worker that the system ends when it has begun to write its revision."""
    from app.builds import revision_build
    from app.jobs import worker

    def begin(path: Path, _: object) -> None:
        path.write_bytes(b"the first bytes")
        os.kill(os.getpid(), signal.SIGKILL)

    vars(revision_build)["write_map"] = begin
    worker.run_job(*arguments)


def take_memory(*arguments: Any) -> None:
    """Be a worker whose build allocates 64 GB; Python's own error of that has no text."""
    from app.jobs import worker

    vars(worker)["build_revision"] = lambda *_, **__: bytearray(2**36)
    worker.run_job(*arguments)


def lose_the_catalog_for_a_moment(*arguments: Any) -> None:
    """Be a worker whose first reports of progress the catalog does not take."""
    from app.jobs import worker
    from storage.catalog.jobs import Jobs
    from storage.errors import StorageBusy, StorageFull, StorageReadOnly, StorageUnavailable

    progress = Jobs.progress
    refusals = [
        StorageUnavailable("restarts"),
        StorageBusy("locked"),
        StorageFull("filled by a backup"),
        StorageReadOnly("a standby"),
        StorageUnavailable("gone"),
    ]

    def refuse_at_first(*given: Any) -> Any:
        if refusals:
            raise refusals.pop()
        return progress(*given)

    vars(worker).update(_REPORT_EVERY_S=0.0, _REPORT_AGAIN_S=0.0)
    setattr(Jobs, "progress", refuse_at_first)  # noqa: B010 - of this process only
    worker.run_job(*arguments)
    assert not refusals


def find_no_catalog(settings: Any, *arguments: Any) -> None:
    """Be a worker that cannot open the catalog."""
    from app.jobs import worker

    url = f"sqlite:///{settings.data_dir}/nowhere/catalog.sqlite3"
    worker.run_job(settings.model_copy(update={"catalog_url": url}), *arguments)


class Undying:
    """A process that waits for a disk that hangs: not even SIGKILL ends it."""

    exitcode = None

    def __init__(self, **_: object) -> None:
        pass

    def start(self) -> None:
        pass

    def kill(self) -> None:
        pass

    def join(self, timeout: float | None = None) -> None:
        assert timeout is not None, "the service would wait for ever"
        time.sleep(timeout)

    def is_alive(self) -> bool:
        return True

    def close(self) -> None:
        raise ValueError("Cannot close a process while it is still running.")
