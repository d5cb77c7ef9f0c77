"""The report as one HTML file: no network, no script, all figures and numbers inside."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from app.report.answer_figures import (
    answers_figure,
    confusion_figure,
    curves_figure,
    relative_error_figure,
)
from app.report.figure import Figure
from app.report.map_figures import nodes_figure
from app.report.sweep_figures import accuracy_figure, size_figure, trade_off_figure
from core.evaluation.advisor import AdviceDecision
from core.evaluation.study import EncodingStudy, Study
from core.progress import NO_PROGRESS, Progress
from core.text import count_of

DECISIONS = {
    AdviceDecision.DECIDED: "Recommended",
    AdviceDecision.UNCONFIRMED: "No larger rank confirms it: the evidence does not decide",
    AdviceDecision.SIZE_ONLY: "Smallest of equals: the evidence does not decide",
    AdviceDecision.TOO_FEW: "Too few scans: the evidence does not decide",
    AdviceDecision.NOTHING_FITS: "Nothing fits the budget",
}


def render_report(
    study: Study,
    provenance: dict[str, str],
    progress: Progress = NO_PROGRESS,
    notes: Sequence[str] = (),
) -> str:
    """Draw all figures and return the page.

    Texts of the drive (its name, reasons why scans were skipped, notes) are escaped.

    Args:
        study: What is shown.
        provenance: What it was made with, by name.
        progress: Receives every figure.
        notes: What is wrong with the drive; above all figures, which may be good in spite of it.
    """
    progress.start("drawing", 2 + 6 * len(study.encodings))

    def drawn(figures: Iterable[Figure]) -> list[Figure]:
        kept = []
        for figure in figures:
            kept.append(figure)
            progress.advance()
        return kept

    common = drawn(draw(study) for draw in (curves_figure, nodes_figure))
    of_each: tuple[Callable[[EncodingStudy], Figure], ...] = (
        trade_off_figure,
        accuracy_figure,
        size_figure,
        partial(answers_figure, study),
        relative_error_figure,
        confusion_figure,
    )
    sections = [
        (encoding, DECISIONS[encoding.advice.decision], drawn(draw(encoding) for draw in of_each))
        for encoding in study.encodings
    ]
    environment = Environment(
        loader=PackageLoader("app.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # For our own drawings only, never for texts of the drive.
    environment.filters["drawing"] = Markup
    return environment.get_template("report.html.j2").render(
        study=study,
        sections=sections,
        common=common,
        provenance=provenance,
        notes=notes,
        configuration=_configuration(study),
    )


def _configuration(study: Study) -> list[tuple[str, str]]:
    rows = [
        ("drive", study.drive),
        ("scans", str(study.scans)),
        ("path", "unknown: no poses" if study.length_m is None else f"{study.length_m:.0f} m"),
        ("standing scans", str(int(study.standing.sum()))),
        ("held out", f"{study.split}, of the drive as a whole"),
        ("a right answer", study.criterion),
        ("seed of the noise", str(study.seed)),
    ]
    for encoding in study.encodings:
        parameters = encoding.parameters
        facts = [
            f"sensor {parameters.sensor}",
            f"{parameters.reducer} {parameters.image} images of"
            f" {parameters.grid.shape[0]} x {parameters.grid.shape[1]}",
            f"{parameters.ranks[0]} x {parameters.ranks[1]}, k = {encoding.segment_length}"
            f" ({count_of(encoding.segments, 'segment')})"
            + ("" if encoding.recommended else ", not the recommended one"),
            f"{count_of(encoding.sweep.map_scans, 'scan')} mapped,"
            f" {count_of(encoding.sweep.queries, 'query', 'queries')},"
            f" {encoding.sweep.counted} count",
        ]
        if parameters.distance is not None and parameters.lateral_renderings_m is not None:
            places = ", ".join(f"{m:g}" for m in parameters.lateral_renderings_m)
            facts += [
                f"{parameters.distance} distance",
                f"sensor {parameters.sensor_height_m:g} m above ground",
                f"rendered from {places} m to the left",
            ]
        if encoding.refused:
            facts.append(f"{count_of(len(encoding.refused), 'scan')} could not be queried")
        rows.append((encoding.name, "; ".join(facts)))
    return rows
