import math

import pytest
from pydantic import ValidationError

from app.cli.chosen_settings import chosen_settings
from app.settings import Settings, is_loopback
from core.errors import InvalidParameters


@pytest.mark.parametrize(
    ("given", "host"),
    [
        ("[::1]", "::1"),
        ("[::ffff:127.0.0.1]", "::ffff:127.0.0.1"),
        ("::1", "::1"),
        ("127.0.0.1", "127.0.0.1"),
        ("maps.example", "maps.example"),
    ],
)
def test_an_ipv6_address_to_listen_on_may_have_the_brackets_of_a_url(given, host) -> None:
    assert Settings(host=given).host == host


def test_an_address_in_brackets_is_as_loopback_as_without_them() -> None:
    assert is_loopback(Settings(host="[::1]").host)
    assert not is_loopback(Settings(host="[2001:db8::1]").host)


@pytest.mark.parametrize(
    "name",
    [name for name, field in Settings.model_fields.items() if "float" in str(field.annotation)],
)
def test_no_time_or_rate_is_infinite_as_json_has_no_such_number(name) -> None:
    with pytest.raises(ValidationError, match="finite"):
        Settings.model_validate({name: math.inf})


@pytest.mark.parametrize(
    "name", [name for name in Settings.model_fields if "_bytes" in name and "_per_s" not in name]
)
def test_no_size_is_more_than_the_system_takes(name) -> None:
    assert getattr(Settings.model_validate({name: 2**63 - 1}), name) == 2**63 - 1
    with pytest.raises(ValidationError, match="less than or equal to 9223372036854775807"):
        Settings.model_validate({name: 2**64 - 1})


@pytest.mark.parametrize("name", ["host", "data_dir"])
def test_an_empty_variable_is_not_all_addresses_or_the_current_folder(name, monkeypatch) -> None:
    monkeypatch.setenv(f"TENSORMAP_{name.upper()}", "")
    with pytest.raises(InvalidParameters, match=f"^TENSORMAP_{name.upper()}: .*it is empty"):
        chosen_settings()


def test_an_empty_url_of_the_catalog_is_as_none(monkeypatch) -> None:
    monkeypatch.setenv("TENSORMAP_CATALOG_URL", "")
    assert Settings().catalog_url is None


@pytest.mark.parametrize("given", ["[maps.example]", "[::1", "[::1]:8000", "[]"])
def test_brackets_of_anything_else_stay(given) -> None:
    assert Settings(host=given).host == given


@pytest.mark.parametrize(
    ("given", "kept"), [("0", 0), (str(2**30), 2**30), ("4096", None), ("1000000", None)]
)
def test_a_build_gets_no_memory_in_which_none_succeeds(given, kept, monkeypatch) -> None:
    monkeypatch.setenv("TENSORMAP_BUILD_MEMORY_BYTES", given)
    if kept is None:
        with pytest.raises(ValidationError, match="wanted 0, for no limit, or at least 268435456"):
            Settings()
    else:
        assert Settings().build_memory_bytes == kept


@pytest.mark.parametrize("given", ["-1", "some", "1.5", "1000001", "", "ALL"])
def test_a_number_of_revisions_that_is_none_is_rejected_with_one_text(given, monkeypatch) -> None:
    monkeypatch.setenv("TENSORMAP_RETAINED_REVISIONS", given)
    with pytest.raises(InvalidParameters) as rejected:
        chosen_settings()
    assert str(rejected.value) == (
        "TENSORMAP_RETAINED_REVISIONS: should be a whole number from 0 to 1000000, or 'all', got"
        f" {given!r}"
    )


@pytest.mark.parametrize(("given", "kept"), [("all", "all"), ("0", 0), (" 1000000", 1_000_000)])
def test_a_number_of_revisions_may_be_all(given, kept, monkeypatch) -> None:
    monkeypatch.setenv("TENSORMAP_RETAINED_REVISIONS", given)
    assert Settings().retained_revisions == kept
