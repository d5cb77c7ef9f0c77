"""A throw-away PostgreSQL cluster on a Unix socket, for the tests of a session.

`initdb` and `pg_ctl` are those of Debian's package `postgresql`. PostgreSQL refuses to run as
root: there, it runs as the user `postgres` that the package makes.
"""

import itertools
import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from sqlalchemy import URL

_START_S = 60
# Nothing here outlives the tests: no waiting for the disk. An English collation, so that an order
# that only holds in ASCII shows.
_INITDB = ("--no-sync", "--auth=trust", "--username=tensormap", "--encoding=UTF8",
           "--locale=C.UTF-8", "--locale-provider=icu", "--icu-locale=en-US")  # fmt: skip
_OPTIONS = "-c fsync=off -c listen_addresses='' -c timezone=Asia/Kolkata -c shared_buffers=16MB"
_EMPTY = (
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
    " WHERE datname = current_database() AND pid <> pg_backend_pid()",
    "DROP SCHEMA public CASCADE",
    "CREATE SCHEMA public",
)


def _binaries() -> Path | None:
    """Return the folder of the newest installed version's programs."""
    found = sorted(
        (p.parent for p in Path("/usr/lib/postgresql").glob("*/bin/initdb")),
        key=lambda folder: float(folder.parent.name),
    )
    if found:
        return found[-1]
    on_path = shutil.which("initdb")
    return Path(on_path).parent if on_path else None


def _user() -> str | None:
    """Return who PostgreSQL has to run as, if not as this user."""
    return "postgres" if os.geteuid() == 0 else None


def reason_to_skip() -> str | None:
    """Return why no cluster can be started here, `None` if one can."""
    if _binaries() is None:
        return "PostgreSQL is not installed: apt-get install postgresql"
    user = _user()
    if user is not None:
        try:
            pwd.getpwnam(user)
        except KeyError:
            return "PostgreSQL does not run as root, and there is no user postgres"
    try:
        import psycopg  # noqa: F401 - only whether it is installed
    except ImportError:
        return "psycopg is not installed: the extra postgresql"
    return None


@dataclass(frozen=True)
class Cluster:
    """A server that runs.

    Attributes:
        folder: Of its socket.
    """

    folder: Path
    _numbers: Iterator[int] = field(default_factory=itertools.count)
    _unused: list[str] = field(default_factory=list)

    def new_database(self) -> str:
        """Make an empty database, whose settings may be changed, and return its URL."""
        return self.url(self._create())

    @contextmanager
    def databases(self) -> Iterator[Callable[[], str]]:
        """Give what makes an empty database and returns its URL, for as long as the block lasts.

        It may be one of an earlier block, emptied: that takes a tenth of the time of a new one.
        """
        used: list[str] = []

        def make() -> str:
            if self._unused:
                name = self._unused.pop()
                self.run(*_EMPTY, database=name)
            else:
                name = self._create()
            used.append(name)
            return self.url(name)

        try:
            yield make
        finally:
            self._unused.extend(used)

    def _create(self) -> str:
        name = f"t{next(self._numbers)}"
        self.run(f"CREATE DATABASE {name} TEMPLATE template0", database="postgres")
        return name

    def url(self, database: str) -> str:
        """Return the URL of a database."""
        url = URL.create(
            "postgresql+psycopg", "tensormap", database=database, query={"host": str(self.folder)}
        )
        return url.render_as_string(hide_password=False)

    def run(self, *statements: str, database: str) -> None:
        """Run statements outside of any transaction."""
        import psycopg  # where there is none, these tests are skipped

        with psycopg.connect(
            host=str(self.folder), user="tensormap", dbname=database, autocommit=True
        ) as connection:
            for statement in statements:
                connection.execute(statement.encode())


@contextmanager
def cluster() -> Iterator[Cluster]:
    """Run a cluster until the block ends, and leave nothing of it behind."""
    binaries = _binaries()
    assert binaries is not None, reason_to_skip()
    # Not pytest's own folder: `postgres` may not enter that of root, and a socket's path is short.
    folder = Path(tempfile.mkdtemp(prefix="tensormap-pg-"))
    user = _user()
    if user is not None:
        shutil.chown(folder, user)
    data = folder / "data"

    def run(program: str, *words: str) -> None:
        # A file, not a pipe: the server keeps what it inherits, and a pipe would never end.
        with (folder / "output").open("a") as output:
            done = subprocess.run(
                [str(binaries / program), *words],
                user=user,
                group=None if user is None else pwd.getpwnam(user).pw_gid,
                extra_groups=None if user is None else [],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=_START_S,
            )
        assert done.returncode == 0, (folder / "output").read_text()

    try:
        run("initdb", *_INITDB, "-D", str(data))
        log = str(folder / "log")
        run("pg_ctl", "start", "-w", "-D", str(data), "-l", log, "-o", f"{_OPTIONS} -k {folder}")
        try:
            yield Cluster(folder)
        finally:
            run("pg_ctl", "stop", "-w", "-m", "immediate", "-D", str(data))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
