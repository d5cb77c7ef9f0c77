import io
import signal

import pytest

from app.cli.standard_streams import UnfailingStream
from app.cli.stop_signals import _Stops


class Gone(io.StringIO):
    """A terminal that hung up."""

    def write(self, _text: str) -> int:
        raise OSError(5, "Input/output error")

    def flush(self) -> None:
        raise OSError(5, "Input/output error")


def test_what_cannot_be_written_is_dropped_and_what_can_be_is_written() -> None:
    for stream in (gone := Gone(), able := io.StringIO()):
        unfailing = UnfailingStream(stream)
        assert unfailing.write("projecting: 3 of 10\n") == 20
        unfailing.flush()
    assert gone.getvalue() == ""
    assert able.getvalue() == "projecting: 3 of 10\n"


def test_only_errors_of_the_output_are_dropped() -> None:
    class Stopped(io.StringIO):
        def write(self, _text: str) -> int:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        UnfailingStream(Stopped()).write("projecting: 3 of 10\n")


def test_a_command_whose_terminal_hung_up_ends_although_it_cannot_say_so(monkeypatch) -> None:
    monkeypatch.setattr("sys.stderr", UnfailingStream(Gone()))
    with pytest.raises(SystemExit) as ended:
        _Stops().terminate(signal.SIGHUP, None)
    assert ended.value.code == 129
