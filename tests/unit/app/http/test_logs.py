"""Log lines: one for each event, readable by machines, without secrets."""

import contextvars
import io
import json
import logging
from urllib.parse import quote, quote_plus

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.http import redaction
from app.http.context import accepted_id, current_id, enter_request, logged_path
from app.http.logs import LineFormatter, _Throttle, configure_logging, fields
from app.settings import LogFormat


@pytest.fixture
def lines():
    """Logs of a format, as they were written; logging is put back as it was."""
    names = ["", "tensormap", "uvicorn", "uvicorn.access", "uvicorn.error", "asyncio"]
    kept = [
        (log, log.handlers[:], log.level, log.disabled, log.filters[:])
        for log in map(logging.getLogger, names)
    ]
    written = io.StringIO()

    def configure(log_format):
        configure_logging(log_format, "INFO", written)
        return written

    yield configure
    for log, handlers, level, disabled, filters in kept:
        log.handlers[:], log.disabled, log.filters[:] = handlers, disabled, filters
        log.setLevel(level)


def log_a_fault(logger):
    try:
        raise ValueError("first line\nsecond line")
    except ValueError:
        logger.exception("it failed")


def test_a_json_line_has_the_event_its_fields_and_its_traceback(lines):
    written = lines(LogFormat.JSON)
    logger = logging.getLogger("tensormap.test")
    logger.info("two\nlines", extra=fields(status=200, path="/v1/maps"))
    log_a_fault(logger)
    first, second = map(json.loads, written.getvalue().splitlines())
    assert (first["event"], first["status"], first["path"]) == ("two\nlines", 200, "/v1/maps")
    assert (first["level"], first["logger"]) == ("info", "tensormap.test")
    assert first["time"].endswith("Z")
    assert second["event"] == "it failed"
    assert "second line" in second["traceback"]


@given(st.text(max_size=40))
def test_a_text_line_stays_one_line_whatever_a_client_sends(path):
    record = logging.makeLogRecord({"name": "tensormap", "msg": "request", **fields(path=path)})
    assert len(LineFormatter(LogFormat.TEXT).format(record).splitlines()) == 1


@pytest.mark.parametrize("sent", ["\x1b[2J", "\x9b2J", "\r", "\u202e", "\u2066", "\ud800"])
def test_a_text_log_holds_nothing_that_changes_how_a_terminal_shows_it(lines, sent):
    """A capture's name may have a mark that turns the text around it, an error what was sent."""
    written = lines(LogFormat.TEXT)
    logger = logging.getLogger("tensormap.test")
    logger.warning("job ended", extra=fields(reason=f"{sent}.bag cannot be read"))
    try:
        raise ValueError(f"{sent} is wrong")
    except ValueError:
        logger.exception("it failed")
    assert sent not in written.getvalue()
    assert f"reason={ascii(sent)[1:-1]}.bag cannot be read\n" in written.getvalue()
    assert f"\nValueError: {ascii(sent)[1:-1]} is wrong\n" in written.getvalue()


@pytest.mark.parametrize("prefix", ["tm", "tmt"])
def test_a_line_has_no_key_and_no_token(lines, prefix):
    key = f"{prefix}_0a1b2c3d_" + "s3cret-" * 6
    for log_format in LogFormat:
        written = lines(log_format)
        logging.getLogger("tensormap").info("request", extra=fields(path=f"/v1/keys/{key}"))
        try:
            raise ValueError(key)
        except ValueError:
            logging.getLogger("tensormap").exception("failed")
        assert "s3cret" not in written.getvalue()
        assert f"{prefix}_(hidden)" in written.getvalue()


def test_a_line_has_no_key_that_an_operator_chose(lines, monkeypatch):
    monkeypatch.setattr(redaction, "_chosen", {})
    key = "a b/c+d\\e'f\"g%h-secret"
    redaction.hide(key)
    written_forms = [
        key,
        quote(key),
        quote(key, safe=""),
        quote(key).lower(),
        quote(quote(key)),
        quote_plus(key),
        json.dumps(key),
        repr(key),
    ]
    for log_format in LogFormat:
        written = lines(log_format)
        for form in written_forms:
            logging.getLogger("tensormap").info("request", extra=fields(path=f"/v1/{form}/x"))
            try:
                raise ValueError(form)
            except ValueError:
                logging.getLogger("tensormap").exception("failed")
        assert "secret" not in written.getvalue()
        assert written.getvalue().count("(hidden)") >= 2 * len(written_forms)


def test_a_long_path_is_cut_where_no_part_of_a_key_is_left(monkeypatch):
    monkeypatch.setattr(redaction, "_chosen", {})
    redaction.hide("0123456789abcdef" * 4)
    path = "/v1/" + "x" * 180 + "/" + "0123456789abcdef" * 4
    assert "0123" not in logged_path({"path": path})


def test_a_line_has_the_id_of_the_request_that_wrote_it(lines):
    def answer():
        enter_request({"headers": [(b"x-request-id", b"truck-7")]})
        assert current_id() == "truck-7"
        logging.getLogger("tensormap").info("during")

    written = lines(LogFormat.JSON)
    logging.getLogger("tensormap").info("before")
    contextvars.copy_context().run(answer)
    before, during = map(json.loads, written.getvalue().splitlines())
    assert "request_id" not in before
    assert during["request_id"] == "truck-7"


@pytest.mark.parametrize("log_format", LogFormat)
def test_nothing_is_written_twice_nor_below_the_level(lines, log_format):
    written = lines(log_format)
    logging.getLogger("tensormap").debug("hidden")
    logging.getLogger("uvicorn.access").info("GET /v1/maps?after=secret")
    logging.getLogger("uvicorn.error").info("started")
    logging.getLogger("another").info("chatter")
    assert len(written.getvalue().splitlines()) == 1
    assert "started" in written.getvalue()


@pytest.mark.parametrize("sent", ["a", "truck-7:42", "01HZX.3_k", "f" * 64])
def test_a_valid_request_id_is_kept(sent):
    assert accepted_id(sent) == sent


@pytest.mark.parametrize("sent", [None, "", "f" * 65, "two words", "a\nb", "é", '{"x":1}', "-a"])
def test_any_other_request_id_is_replaced(sent):
    made = accepted_id(sent)
    assert made != sent
    assert accepted_id(made) == made
    assert made != accepted_id(sent)


def test_events_that_a_client_can_cause_at_will_are_logged_once_in_ten_seconds():
    now = [0.0]
    throttle = _Throttle(lambda: now[0])

    def passes(event):
        return throttle.filter(logging.makeLogRecord({"msg": event}))

    accept = "socket.accept() out of system resource\nsocket: <socket>"
    assert [passes(accept) for _ in range(3)] == [True, False, False]
    assert passes("Invalid HTTP request received.")
    not_text = "Invalid UTF-8 sequence received from client."
    assert [passes(not_text) for _ in range(3)] == [True, False, False]
    assert all(passes("Shutting down") for _ in range(3))
    now[0] = 10.0
    assert [passes(accept), passes(accept)] == [True, False]


def test_text_that_is_not_utf_8_is_logged_without_a_traceback(lines):
    written = lines(LogFormat.TEXT)
    try:
        b"\xff".decode()
    except UnicodeDecodeError:
        logging.getLogger("uvicorn.error").exception("Invalid UTF-8 sequence received from client.")
    [line] = written.getvalue().splitlines()
    assert line.endswith("Invalid UTF-8 sequence received from client.")


def test_a_stream_is_logged_by_us_and_not_by_the_server_with_its_query(lines):
    written = lines(LogFormat.TEXT)
    error = logging.getLogger("uvicorn.error")
    error.info('%s - "WebSocket %s" [accepted]', "127.0.0.1:1", "/v1/maps/m/tracks/t/stream?key=1")
    error.info("connection rejected (%d %s)", 429, "Too Many Requests")
    error.error("ASGI callable returned without completing handshake.")
    error.info("Shutting down")
    [line] = written.getvalue().splitlines()
    assert "Shutting down" in line
