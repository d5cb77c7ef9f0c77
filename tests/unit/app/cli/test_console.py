"""Progress of commands: bars in a terminal, and lines in a log."""

from types import SimpleNamespace

from app.cli.console import progress_bar


def test_work_in_a_log_shows_how_far_it_is_now_and_then_and_at_the_end_of_each_stage(
    monkeypatch, capsys
) -> None:
    clock = iter(range(0, 1000, 2))
    ticking = SimpleNamespace(monotonic=lambda: float(next(clock)))
    monkeypatch.setattr("app.cli.console.time", ticking)
    with progress_bar() as progress:
        progress.start("projecting", 10)
        for _ in range(6):
            progress.advance()
        progress.start("fitting", 2)
    shown = capsys.readouterr().err.splitlines()
    assert shown[0].startswith("projecting: 3 of 10, ")
    assert shown[0].endswith(" s left")
    assert shown[-2:] == ["projecting: 10 of 10", "fitting: 2 of 2"]
    assert len(shown) == 4


def test_a_terminal_has_bars(monkeypatch, capsys) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar() as progress:
        progress.start("projecting", 10)
    assert "━" in capsys.readouterr().err
