import signal
import time

import pytest

from app.cli.stop_signals import _Stops


def test_a_stop_counts_again_where_the_cleanup_hangs(monkeypatch) -> None:
    stops = _Stops()
    clock_s = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: clock_s)
    with pytest.raises(KeyboardInterrupt):
        stops.interrupt(signal.SIGINT, None)
    clock_s = 104.0
    stops.terminate(signal.SIGTERM, None)
    clock_s = 106.0
    with pytest.raises(SystemExit) as ended:
        stops.terminate(signal.SIGTERM, None)
    assert ended.value.code == 143
