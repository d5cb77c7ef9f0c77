"""On whose behalf a change is made, for the audit log."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

EVERYONE_ID = "everyone"
"""Who acts where the service has no keys."""

OPERATOR_ID = "operator"
"""Who acts by the key of the settings, or by a command on the data directory."""

SERVICE_ID = "service"
"""Who acts where nobody asked for it."""


@dataclass(eq=False)
class Act:
    """A change that somebody requests.

    The catalog logs it with the first transaction that is committed on its behalf, so that there is
    no change without its entry, and sets `recorded`.

    Attributes:
        key_id: Who requests it: id of a key, `operator`, `everyone` or `service`.
        action: What is done, as `make_live`: the name of the route's function, or of an act of the
            service or a command.
        subject: The path of the request.
        map_slug: The map that it is about, `None` if it is about none.
        detail: What the subject does not have, as the revision that is made live.
        recorded: Whether it is in the log.
    """

    key_id: str
    action: str
    subject: str
    map_slug: str | None = None
    detail: str = ""
    recorded: bool = False


_current: ContextVar[Act | None] = ContextVar("act", default=None)


def current_act() -> Act | None:
    """Return the act on whose behalf this thread or task works, `None` if there is none."""
    return _current.get()


@contextmanager
def on_behalf(act: Act | None) -> Iterator[None]:
    """Work on behalf of an act, or of none, in this context and in copies of it."""
    token = _current.set(act)
    try:
        yield
    finally:
        _current.reset(token)
