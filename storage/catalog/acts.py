"""Whose change it is that is being made, for the audit log."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

_MOST_CHARACTERS = 300


@dataclass(eq=False)
class Act:
    """A change that somebody asks for.

    The catalog writes it down with the first transaction that is committed on its behalf, so that
    there is no change without its entry, and sets `recorded`.

    Attributes:
        key_id: Who asks: id of a key, `operator`, `everyone` or `service`.
        action: What is done, as `PUT /v1/maps/{map}/live`.
        subject: To what, as the path that was asked for.
        map_slug: The map that it is about, `None` if it is about none.
        detail: What the subject does not say, as the revision that is made live.
        recorded: Whether it is in the log.
    """

    key_id: str
    action: str
    subject: str
    map_slug: str | None = None
    detail: str = ""
    recorded: bool = False

    def values(self, outcome: str) -> dict[str, str | None]:
        """Return what the log keeps of it."""
        return {
            "key_id": self.key_id,
            "action": self.action[:_MOST_CHARACTERS],
            "subject": self.subject[:_MOST_CHARACTERS],
            "map_slug": self.map_slug,
            "detail": self.detail[:_MOST_CHARACTERS],
            "outcome": outcome,
        }


_current: ContextVar[Act | None] = ContextVar("act", default=None)


def current_act() -> Act | None:
    """Return the act on whose behalf this thread or task works, `None` if it is nobody's."""
    return _current.get()


@contextmanager
def on_behalf(act: Act | None) -> Iterator[None]:
    """Work on behalf of an act, or of nobody, in this context and in copies of it."""
    token = _current.set(act)
    try:
        yield
    finally:
        _current.reset(token)
