"""`tensormap verify`: checks of every stored file."""

import os
from contextlib import suppress
from typing import Annotated

import typer

from app.cli.chosen_settings import chosen_settings
from app.cli.console import progress_bar, say
from app.cli.opened_store import require_catalog
from app.cli.options import DataOption
from app.process import private_files
from core.errors import InvalidParameters, TensorMapError
from core.text import count_of
from storage.catalog import OPERATOR_ID, Act
from storage.store import Store
from storage.store.verification import Finding
from storage.store.verification import verify as verify_store


def verify(
    data: DataOption = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair", help="Set aside what is damaged and sweep; the service must be stopped."
        ),
    ] = False,
) -> None:
    """Check every stored file against its digest, and list what is damaged, missing or left over.

    The exit status is 1 if a file that the catalog names is damaged or missing; files that are left
    over do no harm. A file that may be an only copy is never removed.
    """
    settings = chosen_settings(data_dir=data)
    require_catalog(settings.data_dir, settings.catalog_url)
    owner = settings.data_dir.stat().st_uid
    if repair and owner != os.geteuid():  # the service could not read the files that it makes
        raise InvalidParameters(
            f"{settings.data_dir} belongs to user {owner}, this is user {os.geteuid()}: repair it"
            " as its owner, with sudo -u"
        )
    private_files()
    with Store(settings.data_dir, settings.catalog_url) as store, progress_bar() as bar:
        found = verify_store(store, repair=repair, progress=bar)
        repaired = [one for one in found.findings if one.done and one.described]
        if repaired:
            files = f"{count_of(len(repaired), 'file')}, the first {repaired[0].path}"
            detail = f"{files}: {repaired[0].done}"
            act = Act(OPERATOR_ID, "repair_files", "/v1/maps", detail=detail)
            with suppress(TensorMapError):  # of a damaged catalog, which is among the findings
                store.audit.append(act, "done")
    for finding in found.findings:
        say(_line(finding))
    losses = sum(finding.is_loss for finding in found.findings)
    say(
        f"{settings.data_dir}: {count_of(found.files, 'file')} checked, {losses} damaged or missing"
    )
    if not found.is_whole:
        raise typer.Exit(1)


def _line(finding: Finding) -> str:
    path, described = finding.path, finding.described
    notes = "; ".join(note for note in (path if described else "", finding.done) if note)
    line = f"{finding.condition}: {described or path}: {finding.what}"
    return f"{line} ({notes})" if notes else line
