"""The command ``fmuid batch``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from typer import Option

from fmuid import runs, studies
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, Figures, NoReport, Overrides, StudyFile, showing_findings
from fmuid.apps.cli.signals import answering
from fmuid.apps.cli.studies import telling_files
from fmuid.reports import render, topics


@showing_findings
def batch(
    study: StudyFile,
    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="Folder of the batch.", show_default=False)],
    set_: Overrides = None,
    scheduler: Annotated[
        str | None, Option(metavar="ADDRESS", help="Dask scheduler, tcp://host:8786 (default: local workers).")
    ] = None,
    workers: Annotated[int | None, Option(metavar="N", help="Number of local workers (default: one per core).")] = None,
    max_cases: Annotated[int, Option(metavar="N", help="Refuse a study with more cases.")] = 100_000,
    resume: Annotated[
        bool, Option("--resume/--no-resume", help="Keep finished cases, or remove them and begin anew.")
    ] = True,
    no_isolation: Annotated[
        bool, Option("--no-isolation", help="Run FMUs inside the workers; an FMU that crashes ends one.")
    ] = False,
    figures: Figures = None,
    no_report: NoReport = False,
) -> int:
    """Run the identifications of a study's [batch]; the same command resumes them."""
    read = studies.Study.read(study, set_ or ())
    job = runs.Batch(read, output, scheduler=scheduler, workers=workers, max_cases=max_cases, isolated=not no_isolation)
    render.show_notes(topics.source_notes(read))
    with answering("saving the finished cases, then their summary (Ctrl-C skips it)"):
        with render.Display() as display:
            found = job.run(display, resume=resume)
        with telling_files():
            return _show(job, found, figures, report=not no_report)


def _show(job: runs.Batch, found: runs.BatchResult, figures: str | None, *, report: bool) -> int:
    """Show and write the finished cases of a batch."""
    logs = len(list(job.dataset.logs.glob("case-*.txt")))
    said = [f"{path}: damaged, removed. Its cases run again." for path in found.lost]
    said += [f"Output and warnings of {logs} cases: {job.dataset.logs}"] if logs else []
    render.show_notes(said)
    if found.finished:
        from fmuid.reports.publish import publish

        summary, frame = found.summary(), found.frame
        written = topics.write_summary(found, summary, job.study)
        document = topics.batch_document(found, summary, frame, job.study)
        render.show(document)
        written += publish(job.folder, document, report=report, figures=figures)
        render.show_files([*job.dataset.files(), *written])
    if found.interrupted:
        print(
            f"interrupted: {found.finished} of {found.total} cases are finished; the same command resumes",
            file=sys.stderr,
        )
        return NOT_SUCCEEDED
    return DONE
