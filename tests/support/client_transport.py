"""Transports of the client that answer without a network, and wait in no time."""

import random

import httpx2
from tensormap_client._sync import transport as module
from tensormap_client._sync.transport import Transport

LOST = httpx2.ReadError("connection reset")
OK = httpx2.Response(200, json={})


class Service:
    """Answers with each of some answers in turn; raises those that are errors."""

    def __init__(self, *answers: httpx2.Response | Exception) -> None:
        self.answers = list(answers)
        self.requests: list[httpx2.Request] = []

    def __call__(self, request: httpx2.Request) -> httpx2.Response:
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def transport(self, patience_s: float = 300.0) -> Transport:
        return Transport(
            "http://maps.example/under",
            "the-key",
            timeout_s=2.0,
            patience_s=patience_s,
            connections=httpx2.MockTransport(self),
        )


class Clock:
    """The transport's clock: it goes on while the transport waits."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.waited_s: list[float] = []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.waited_s.append(seconds)
        self.now_s += seconds


def problem(status: int, name: str, detail: str) -> httpx2.Response:
    return httpx2.Response(status, json={"type": f"/problems/{name}", "detail": detail})


def replace_clock(monkeypatch) -> Clock:
    """Let transports wait in no time, and as long as they may; return their clock."""
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(module, "sleep", clock.sleep)
    monkeypatch.setattr(random, "uniform", lambda _low, high: high)
    return clock
