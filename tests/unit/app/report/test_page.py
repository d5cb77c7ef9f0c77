"""`tensormap report`: one page that parses, holds every figure and needs no network."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from app.cli import report as command
from app.cli.main import cli
from app.provenance import commit, machine
from app.report.answer_figures import confusion_figure
from app.report.figure import Table
from app.report.page import render_report
from app.report.sweep_figures import size_figure, trade_off_figure
from core.encodings.registry import encoding_names
from core.errors import InvalidParameters
from core.evaluation.study_drive import StudyProtocol, segment_lengths_for, study_drive
from core.parameters import MapParameters
from core.projection.images import Skipped
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan
from tests.support.recording import kitti, recording

pytestmark = pytest.mark.slow

VOID = {"meta", "link", "br", "img", "hr", "input"}
MADE = {"made": "2026-01-01", "version": "1"}
NASTY = 'a<script>alert("x")</script>&amp;{{ 7 * 7 }}'


class Page(HTMLParser):
    """Elements of a page; fails where they are not nested."""

    def __init__(self, text):
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.words: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_data(self, data):
        self.words.append(data)


def run(*arguments):
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def protocol(encodings=("paper", "harmonic"), **options):
    """A small study."""
    few = {"noise_m": (0.0, 0.5), "lateral_m": (0.0, 1.0), "yaw_deg": (0.0, 90.0)}
    return StudyProtocol(
        tuple(
            MapParameters.for_sensor(
                encoding=encoding,
                lateral_renderings_m=(0.0, 1.5) if encoding == "harmonic" else None,
            )
            for encoding in encodings
        ),
        **({"r1": (2, 4), "r2": (2, 4), "segment_lengths": (10, 20)} | few | options),
    )


@pytest.fixture(scope="module")
def study():
    return study_drive(MemoryDrive(NASTY, recording(scans=40).scans), protocol())


@pytest.fixture(scope="module")
def page(study):
    return render_report(study, MADE)


@pytest.fixture(scope="module")
def chosen():
    """Of one encoding, with settings that nothing recommends."""
    options = {"ranks": (3, 3), "segment_length": 8, "max_bytes_per_scan": 1.0, "max_queries": 3}
    drive = MemoryDrive("d", recording(scans=40).scans)
    return study_drive(drive, protocol(["paper"], **options))


@pytest.fixture(scope="module")
def noted(chosen):
    """The page of a drive with a note, and with scans that were left out."""
    left_out = (Skipped(3, "it is empty"), Skipped(17, f"the file is {NASTY}"))
    return render_report(replace(chosen, skipped=left_out), MADE, notes=("its poses jump",))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A drive as scan files, without poses."""
    folder = tmp_path_factory.mktemp("drive")
    for index, scan in enumerate(recording(scans=30).scans):
        (folder / f"{index:06}.bin").write_bytes(kitti(scan))
    return folder


def test_the_page_is_well_formed_and_every_id_is_its_own(page) -> None:
    parsed = Page(page)
    assert len(set(parsed.ids)) == len(parsed.ids)
    named = {value[1:] for name, value in parsed.attributes if name == "href"}
    assert named <= set(parsed.ids)
    clipped = set(re.findall(r"url\(#([^)]+)\)", page))
    assert clipped <= set(parsed.ids)


def test_it_needs_no_network_and_runs_no_script(page) -> None:
    parsed = Page(page)
    assert not {"script", "link", "img", "iframe", "object"} & set(parsed.tags)
    assert "://" not in page
    assert "@import" not in page
    assert not [name for name, _ in parsed.attributes if name.startswith("on")]
    assert "default-src 'none'" in page


def test_it_holds_every_figure_of_the_paper_for_each_encoding(page) -> None:
    ids = set(Page(page).ids)
    of_each = ("trade-off", "sweep", "size", "answers", "relative-error", "confusion")
    expected = {f"{encoding}-{figure}" for encoding in encoding_names() for figure in of_each}
    assert expected | {"disturbances", "nodes", "advice", "made"} <= ids
    # By encoding: 1 trade-off, 2 accuracies, 4 of answers, 1 error, 1 matrix. 4 of size: those of
    # harmonic maps do not differ.
    assert page.count('<div role="img"') == 2 * (1 + 2 + 4 + 1 + 1) + 4 + 3 + 2


def test_every_drawing_has_a_name_and_words_and_follows_the_theme(page) -> None:
    assert page.count("<figcaption><b>") == page.count("<svg ") == page.count('role="img"')
    assert "#0102" not in page
    assert "var(--series-1)" in page
    assert "prefers-color-scheme: dark" in page
    colours = re.findall(r"#[0-9a-f]{6}\b", page[page.index("</style>") :])
    assert colours == []


def test_numbers_of_an_axis_are_decimals_without_a_power(page) -> None:
    """Matplotlib writes a power of ten as two pieces of text, the second of them raised."""
    texts = re.findall(r"<text[^>]*>(.*?)</text>", page, re.DOTALL)
    assert texts
    assert not [text for text in texts if "<tspan" in text or "\u00d7" in text]


def test_words_are_explained_and_the_contents_lead_to_every_part(page) -> None:
    headings = re.findall(r'<h2 id="([^"]+)">', page)
    contents = page[page.index("<nav") : page.index("</nav>")]
    assert re.findall(r'href="#([^"]+)"', contents) == headings
    words = page[page.index('<h2 id="words">') :]
    for word in ("r1, r2", "k", "paper", "harmonic", "Signature", "Held out", "Motion surrogate"):
        assert f"<dt>{word}</dt>" in words
    # Letters of the paper's figures are none of ours.
    assert not re.findall(r"<b>\([a-g]", page)


def test_the_contents_lead_to_notes_on_the_drive_where_there_are_some(noted) -> None:
    contents = noted[noted.index("<nav") : noted.index("</nav>")]
    assert re.findall(r'href="#([^"]+)"', contents) == re.findall(r'<h2 id="([^"]+)">', noted)


def test_numbers_are_printed_though_they_are_folded_on_the_screen(page) -> None:
    printed = page[page.index("@media print") : page.index("</style>")]
    assert "details::details-content" in printed
    assert "details:not([open]) { display: none; }" not in printed
    assert ".caption { break-after: avoid; }" in printed


def test_words_of_the_drive_are_escaped(page) -> None:
    assert NASTY in "".join(Page(page).words)
    assert "<script" not in page
    title = page[page.index("<title>") : page.index("</title>")]
    assert "{{ 7 * 7 }}" in title


def test_scans_that_are_left_out_are_listed_with_the_escaped_reason(noted) -> None:
    words = "".join(Page(noted).words)
    assert "scan 3: it is empty" in words
    assert f"scan 17: the file is {NASTY}" in words


def test_the_tables_hold_the_numbers_of_the_study(study, page) -> None:
    for of in study.encodings:
        for point in of.sweep.points:
            assert f"<td>{point.bytes_per_scan:.0f}</td>" in page
    assert page.count("<table>") == 3 + 1 + 2 * 4


def test_the_caption_of_storage_names_what_its_bytes_are(study) -> None:
    for of in study.encodings:
        caption = size_figure(of).caption
        all_of_4_bytes = all(
            round(p.bytes_per_scan * of.sweep.map_scans) == 4 * p.elements for p in of.sweep.points
        )
        assert all_of_4_bytes == (of.name == "paper")
        assert "4 bytes" not in caption
        if of.sweep.sizes_differ:
            assert "the bytes of the map's bases, signatures and verification images" in caption
        else:
            # 11 of header, 8 of view, 2 of scale, and r1 (2 r2 - 1) of {2, 2} and {4, 4}.
            assert caption.endswith("r1 and r2 are what a vehicle sends, 27 to 49 bytes a query.")
            assert size_figure(of).panels == ()


def test_accuracy_is_drawn_against_what_differs(study) -> None:
    by_storage, by_sent = (trade_off_figure(of) for of in study.encodings)
    assert by_storage.title == "Right answers against storage"
    assert by_sent.title == "Right answers against bytes sent"
    assert "between 27 and 49 bytes sent a query" in by_sent.panels[0].alt


def test_a_study_has_the_answers_of_the_recommended_map(study) -> None:
    for of in study.encodings:
        point = of.sweep.at(of.parameters.ranks, of.segment_length)
        assert of.recommended
        assert point == of.advice.recommended
        moving = ~of.answers.standing
        assert point.accuracy[0] == of.answers.right[moving].mean()
        assert point.segment_accuracy == (~of.answers.wrong_segment)[moving].mean()
        assert of.answers.confusion(of.segments).sum() == len(of.answers.scan)
        for quantity in ("noise_m", "lateral_m", "yaw_deg"):
            curve = of.curve(quantity)
            assert [getattr(p.condition, quantity) for p in curve] == sorted(
                getattr(protocol(), quantity)
            )
            undisturbed = next(p for p in curve if getattr(p.condition, quantity) == 0.0)
            assert undisturbed.right == of.answers.right[moving].sum()


def test_the_page_says_what_its_accuracy_and_bands_leave_out(page) -> None:
    text = " ".join(page.split())
    assert "The accuracy below is of the same scans, and somewhat too high" in text
    assert "consecutive scans are alike, so that the true bands are wider" in text
    assert "if they were independent. Consecutive scans are alike: it differs by more." in text


def test_of_many_segments_only_the_confused_ones_are_listed(study) -> None:
    of = study.encodings[0]
    matrix = of.answers.confusion(of.segments)
    cells = [(int(i), int(j), int(matrix[i, j])) for i, j in np.argwhere(matrix)]
    assert of.answers.confused() == cells
    assert of.as_dict()["confusion"] == [list(cell) for cell in cells]
    [whole] = confusion_figure(of).tables
    assert len(whole.headings) == 1 + of.segments
    many = replace(of, segment_start=np.arange(41))
    [table] = confusion_figure(many).tables
    assert table.headings == ("true segment", "found on", "scans")
    assert len(table.rows) == len(cells)


def test_a_harmonic_map_is_more_accurate_at_90_degrees_of_relative_yaw(study) -> None:
    by_encoding = {of.parameters.encoding: of.curve("yaw_deg") for of in study.encodings}
    at_90_deg = by_encoding["harmonic"][-1]
    assert at_90_deg.condition.yaw_deg == 90.0
    assert at_90_deg.right > by_encoding["paper"][-1].right


def test_figures_can_be_of_a_chosen_setting_and_the_same_study_is_the_same_page(chosen) -> None:
    for of in chosen.encodings:
        assert (of.parameters.ranks, of.segment_length, of.recommended) == ((3, 3), 8, False)
        assert of.advice.recommended is None
        assert len(of.answers.scan) == 3
    page = render_report(chosen, {})
    assert "Nothing fits the budget" in page
    assert render_report(chosen, {}) == page


def test_the_command_writes_a_page_and_numbers_of_a_drive_without_poses(folder, tmp_path) -> None:
    out, numbers = tmp_path / "report.html", tmp_path / "report.json"
    message = run(
        "report", folder, "-o", out, "--json", numbers, "--quick", "--encoding", "paper",
        "--k", "10,15", "--r1", "3,5", "--ranks", "5,5",
    ).stdout  # fmt: skip
    assert "does not decide" in message
    page = out.read_text()
    assert "has no poses: there is no map to draw" in page
    assert "harmonic-sweep" not in Page(page).ids
    written = json.loads(numbers.read_text())
    assert written["length_m"] is None
    assert written["made"]["version"]
    (of,) = written["encodings"]
    assert of["parameters"]["ranks"] == [5, 5]
    assert {tuple(p["ranks"]) for p in of["sweep"]["points"]} == {
        (r1, r2) for r1 in (3, 5) for r2 in (3, 5, 8)
    }
    assert of["answers"]["distance_m"] == [None] * 6


@pytest.mark.parametrize("options", [["--r1", "3,x"], ["--k", "0"], ["--max-bytes-per-scan", "0"]])
def test_invalid_options_are_rejected_and_nothing_is_written(folder, tmp_path, options) -> None:
    out = tmp_path / "report.html"
    assert run("report", folder, "-o", out, *options).exit_code == 2
    assert not out.exists()


def test_without_matplotlib_and_jinja2_the_error_has_what_to_install(
    folder, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    with pytest.raises(typer.BadParameter, match=r"matplotlib and jinja2.*\[report\]"):
        command._require_drawing()
    assert run("report", folder, "-o", tmp_path / "report.html").exit_code == 2


def test_segments_of_a_drive_are_at_least_ten_scans_and_multiples_of_five() -> None:
    for scans in range(1, 2000, 7):
        lengths = segment_lengths_for(scans)
        assert list(lengths) == sorted(set(lengths))
        assert all(k >= 10 and k % 5 == 0 for k in lengths)


def test_all_scans_of_a_stationary_drive_count() -> None:
    scan = recording().scans[0]
    drive = MemoryDrive("d", [Scan(scan.points_m, i / 10, scan.pose) for i in range(20)])
    found = study_drive(drive, protocol(["paper"]))
    assert found.standing.all()
    for of in found.encodings:
        assert of.sweep.counted == 4
        assert np.all(of.answers.right)
    assert "Scans of a stationary vehicle count, as all are." in render_report(found, {})


def test_the_machine_is_named_wherever_it_can_be(tmp_path) -> None:
    reported = tmp_path / "cpuinfo"
    reported.write_text("processor : 0\nmodel name : Engine 9\n")
    assert machine(reported) == "Engine 9"
    assert machine(tmp_path / "absent")
    assert commit() is None or re.match(r"[0-9a-f]{12}|v", commit() or "")


def test_a_table_whose_rows_do_not_have_its_columns_is_rejected() -> None:
    with pytest.raises(InvalidParameters, match="does not fit"):
        Table("t", ("a", "b"), (("1",),))
