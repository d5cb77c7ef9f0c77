"""Progress of commands, bars in a terminal and lines in a log, and their tables."""

import sys
from types import SimpleNamespace

import pytest
from rich.table import Table

from app.cli.console import progress_bar, say, show


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


def test_the_last_line_of_a_stage_comes_once_although_work_goes_on_behind_its_end(
    monkeypatch, capsys
) -> None:
    clock = iter(range(0, 1000, 6))
    ticking = SimpleNamespace(monotonic=lambda: float(next(clock)))
    monkeypatch.setattr("app.cli.console.time", ticking)
    with progress_bar() as progress:
        for stage in ("fitting", "calibrating"):
            progress.start(stage, 2)
            progress.advance(2)
    assert capsys.readouterr().err.splitlines() == ["fitting: 2 of 2", "calibrating: 2 of 2"]


def test_a_terminal_has_bars(monkeypatch, capsys) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar() as progress:
        progress.start("projecting", 10)
    assert "━" in capsys.readouterr().err


def test_output_is_not_mixed_with_bars(monkeypatch, capsys) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar(beside_output=True) as progress:
        progress.start("localizing", 10)
        sys.stdout.write("an answer\n")
    shown = capsys.readouterr()
    assert "━" in shown.err
    assert shown.out == "an answer\n"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    with progress_bar(beside_output=True) as progress:
        progress.start("localizing", 10)
    assert capsys.readouterr().err == "localizing: 10 of 10\n"


CELLS = ("000101.bin", "kitti_drive0001 101", "-119.98", "0.1742")


def _shown(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    columns: int | None,
    name: str = CELLS[0],
) -> str:
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", str(columns))
    table = Table("scan", "map scan", "turn deg", "distance")
    table.add_row(name, *CELLS[1:])
    show(table)
    return capsys.readouterr().out


@pytest.mark.parametrize("columns", [20, 40, 60, None])
def test_no_figure_of_a_table_is_cut_off_in_a_narrow_terminal(monkeypatch, capsys, columns) -> None:
    shown = _shown(monkeypatch, capsys, columns)
    assert all(shown.count(cell) == 1 for cell in CELLS)
    assert "…" not in shown


def test_a_table_that_does_not_fit_has_no_borders_and_headings_of_two_lines(
    monkeypatch, capsys
) -> None:
    narrow = _shown(monkeypatch, capsys, 50)
    assert "│" not in narrow
    assert "turn deg" not in narrow
    assert max(map(len, narrow.splitlines())) <= 50
    wide = _shown(monkeypatch, capsys, 80)
    assert "│" in wide
    assert "turn deg" in wide


def test_a_name_longer_than_lines_of_a_file_is_shown_whole(monkeypatch, capsys) -> None:
    name = f"{'long' * 60}.bin"
    assert name in _shown(monkeypatch, capsys, None, name)


NAMES = ("scan[old].bin", "a:car:b.bin", "x[/y].bin", "[red]x.bin")


@pytest.mark.parametrize("name", NAMES)
def test_names_are_shown_as_they_are(monkeypatch, capsys, name) -> None:
    assert f" {name} " in _shown(monkeypatch, capsys, None, name)
    say(f"{name}: 3 scans")
    assert capsys.readouterr().out == f"{name}: 3 scans\n"
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar() as progress:
        progress.start(name, 10)
    assert name in capsys.readouterr().err


LONG = (
    "2011_09_26_drive_0104_sync_evening_second_pass 101",
    "2011_09_26_drive_0104_sync_morning_first_pass 2304",
)


def _shown_in(monkeypatch, capsys, columns: int | None) -> list[str]:
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", str(columns))
    table = Table("scan", "segment", "map scan", "turn deg", "distance")
    table.add_row(LONG[0], "11", LONG[1], "-119.98", "0.1742")
    show(table, names=("scan", "map scan"))
    shown: str = capsys.readouterr().out
    return shown.splitlines()


@pytest.mark.parametrize("columns", [60, 80])
def test_long_names_lose_their_middle_in_a_terminal_that_is_too_narrow(
    monkeypatch, capsys, columns
) -> None:
    lines = _shown_in(monkeypatch, capsys, columns)
    assert max(map(len, lines)) <= columns
    [row] = [line for line in lines if "…" in line]
    scan, segment, map_scan, *figures = (
        row.replace(" 101", "_101").replace(" 2304", "_2304").split()
    )
    assert (segment, figures) == ("11", ["-119.98", "0.1742"])
    assert scan.startswith("2011")
    assert scan.endswith("pass_101")
    assert map_scan.startswith("2011")
    assert map_scan.endswith("pass_2304")


@pytest.mark.parametrize("columns", [200, None])
def test_long_names_are_whole_where_they_fit_and_in_files(monkeypatch, capsys, columns) -> None:
    shown = "\n".join(_shown_in(monkeypatch, capsys, columns))
    assert all(name in shown for name in LONG)


def test_names_keep_some_characters_in_a_terminal_that_is_far_too_narrow(
    monkeypatch, capsys
) -> None:
    shown = "\n".join(_shown_in(monkeypatch, capsys, 20))
    assert "201…pass 101" in shown
    assert "201…ass 2304" in shown
