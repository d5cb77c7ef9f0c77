"""Which connections are closed first where all are taken."""

from app.http.connection_slots import ConnectionSlots


class Idle:
    """A connection that only notes that it was closed."""

    def __init__(self, closed, name):
        self.closed, self.name = closed, name

    def close_now(self):
        self.closed.append(self.name)


def test_idle_connections_are_closed_in_order_and_the_log_line_comes_once_in_ten_seconds(caplog):
    now = [0.0]
    closed: list[str] = []
    slots = ConnectionSlots(4, clock=lambda: now[0])
    kept, first, second, busy = (Idle(closed, name) for name in ("kept", "first", "second", "busy"))
    slots.idle(kept, used=True)
    for fresh in (first, busy, second):
        slots.idle(fresh, used=False)
    slots.busy(busy)
    assert slots.has_room(4)
    assert [slots.has_room(5) for _ in range(5)] == [True, True, True, False, False]
    assert closed == ["first", "second", "kept"]
    assert len(caplog.records) == 1
    now[0] = 10.0
    assert not slots.has_room(5)
    assert "2 that waited for their clients were closed for others, 3 were refused" in caplog.text


def test_of_connections_in_use_those_are_closed_whose_clients_have_their_answer_or_do_not_read():
    now = [0.0]
    closed: list[str] = []
    slots = ConnectionSlots(4, clock=lambda: now[0])
    idle, answered, slow, hung = (
        Idle(closed, name) for name in ("idle", "answered", "slow", "hung")
    )
    slots.unread(hung)
    slots.unread(slow)
    slots.answered(answered)
    slots.idle(idle, used=True)
    assert slots.has_room(4)
    assert [slots.has_room(5) for _ in range(3)] == [True, True, False]
    now[0] = 3.0
    slots.read(slow)  # a part of a large answer
    slots.unread(slow)
    now[0] = 6.0
    assert [slots.has_room(5) for _ in range(2)] == [True, False]
    assert closed == ["idle", "answered", "hung"]
