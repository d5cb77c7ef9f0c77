"""What a client accepts, by its weights."""

import pytest

from app.http.accepted import is_preferred

PACKED = "application/vnd.tensormap.fix"


@pytest.mark.parametrize(
    "accept",
    [
        PACKED,
        f"{PACKED}, application/json",
        f"application/json;q=0.5, {PACKED.upper()} ; Q=0.6",
        f"*/*;q=0.1, {PACKED};q=0.2",
        f"{PACKED};q=0.5",
        f"text/html, {PACKED};q=none",
        f"application/json;q=0.5, {PACKED};q=0_1",
    ],
)
def test_a_type_that_is_named_is_preferred_to_json_unless_that_weighs_more(accept):
    assert is_preferred(PACKED, accept)


@pytest.mark.parametrize(
    "accept",
    [
        None,
        "",
        "*/*",
        "application/json",
        f"{PACKED};q=0",
        f"{PACKED};q=0, application/json",
        f"{PACKED};q=0.2, application/json;q=0.5",
        f"{PACKED};q=0.2, */*;q=0.5",
        f"{PACKED};q=0.2, application/*;q=0.5, */*;q=0",
        f"{PACKED}-other",
    ],
)
def test_json_is_sent_where_it_weighs_more_or_the_type_is_not_named(accept):
    assert not is_preferred(PACKED, accept)
