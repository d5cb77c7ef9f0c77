"""Rate limits: what is allowed in any time is bounded, and the limit is reported."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.access.rate_limits import _MOST_BUCKETS, BYTES, RateLimits
from app.http.errors import TooManyRequests


class Clock:
    now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def takes(limits, who):
    try:
        limits.take(who)
    except TooManyRequests:
        return False
    return True


def test_zero_limits_nothing():
    limits = RateLimits(0.0, 1)
    assert [limits.take("fleet") for _ in range(100)] == [{}] * 100


def test_a_burst_is_allowed_and_then_the_rate(clock):
    limits = RateLimits(2.0, 5, clock)
    assert [takes(limits, "fleet") for _ in range(7)] == [True] * 5 + [False] * 2
    clock.now_s += 1.0
    assert [takes(limits, "fleet") for _ in range(3)] == [True, True, False]
    clock.now_s += 1000.0
    assert [takes(limits, "fleet") for _ in range(6)] == [True] * 5 + [False]


def test_each_sender_has_a_bucket_of_its_own(clock):
    limits = RateLimits(1.0, 1, clock)
    assert takes(limits, "fleet")
    assert not takes(limits, "fleet")
    assert takes(limits, "other")


def test_what_is_left_and_when_to_retry_is_reported(clock):
    limits = RateLimits(0.5, 3, clock)
    assert limits.take("fleet") == {
        "RateLimit-Policy": '"requests";q=3;w=6',
        "RateLimit": '"requests";r=2;t=2',
    }
    limits.take("fleet")
    limits.take("fleet")
    with pytest.raises(TooManyRequests, match="wait 2 s") as rejected:
        limits.take("fleet")
    assert rejected.value.headers == {
        "Retry-After": "2",
        "RateLimit-Policy": '"requests";q=3;w=6',
        "RateLimit": '"requests";r=0;t=6',
    }
    clock.now_s += 2.0
    assert limits.take("fleet")["RateLimit"] == '"requests";r=0;t=6'


@pytest.mark.parametrize("daily", [750_000_000, 3_000_000_000, 12_000_000_000, 11])
def test_a_quota_of_a_day_is_reported_as_one_of_86400_seconds(clock, daily):
    limits = RateLimits(daily / 86_400, daily, clock, BYTES)
    assert limits.take("fleet", daily) == {
        "RateLimit-Policy": f'"bytes";q={daily};qu="content-bytes";w=86400',
        "RateLimit": '"bytes";r=0;t=86400',
    }


def test_a_bucket_of_bytes_takes_many_at_once_or_none(clock):
    limits = RateLimits(10.0, 1000, clock, BYTES)
    assert limits.take("fleet", 600) == {
        "RateLimit-Policy": '"bytes";q=1000;qu="content-bytes";w=100',
        "RateLimit": '"bytes";r=400;t=60',
    }
    rejected = r"1000 bytes of bodies and messages a day .* wait 20 s"
    for method in (limits.take, limits.require):
        with pytest.raises(TooManyRequests, match=rejected):
            method("fleet", 600)
    assert limits.require("fleet", 400) == limits.take("fleet", 0)
    with pytest.raises(TooManyRequests, match="wait 60 s"):  # never fits, whatever the wait
        limits.take("fleet", 5000)


def test_buckets_are_bounded(clock):
    limits = RateLimits(1.0, 1, clock)
    for number in range(_MOST_BUCKETS + 5):
        limits.take(f"address {number}")
    assert len(limits._buckets) == _MOST_BUCKETS


def test_a_sender_that_goes_on_keeps_its_bucket_when_many_others_come(clock):
    limits = RateLimits(1.0, 1, clock)
    limits.take("fleet")
    for number in range(_MOST_BUCKETS - 1):
        limits.take(f"address {number}")
    assert not takes(limits, "fleet")
    limits.take("one more")
    assert not takes(limits, "fleet")
    assert takes(limits, "address 0")


@given(
    rate=st.floats(0.01, 1000),
    burst=st.integers(1, 50),
    waits_s=st.lists(st.floats(0, 10), max_size=60),
)
def test_no_pattern_of_requests_gets_more_than_the_burst_and_the_rate(rate, burst, waits_s):
    clock = Clock()
    limits = RateLimits(rate, burst, clock)
    allowed = 0
    for wait_s in waits_s:
        clock.now_s += wait_s
        allowed += takes(limits, "fleet")
    assert allowed <= burst + rate * sum(waits_s) + 1e-6


@given(rate=st.floats(0.01, 1000), burst=st.integers(1, 50))
def test_a_sender_that_waits_as_long_as_reported_is_allowed(rate, burst):
    clock = Clock()
    limits = RateLimits(rate, burst, clock)
    for _ in range(burst):
        limits.take("fleet")
    try:
        limits.take("fleet")
    except TooManyRequests as rejected:
        clock.now_s += int(rejected.headers["Retry-After"])
    assert takes(limits, "fleet")
