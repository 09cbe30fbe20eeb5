"""The command ``fmuid open``: parse, call, print."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from fmuid.apps.cli.options import DONE


def open_(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="[STUDY or FOLDER]", help="A study file, or a folder that has some.", show_default=False
        ),
    ] = Path(),
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Show it in the browser, or print the address only.")
    ] = True,
    port: Annotated[int, typer.Option("--port", metavar="N", help="Default: any free one.", show_default=False)] = 0,
    listen: Annotated[
        str | None,
        typer.Option(
            "--listen",
            metavar="HOST",
            help="Let other machines in, by this name or address of this one; needs --certificate and --key.",
        ),
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option("--certificate", metavar="FILE", help="PEM file of the certificate for TLS.")
    ] = None,
    key: Annotated[Path | None, typer.Option("--key", metavar="FILE", help="PEM file of its key.")] = None,
) -> int:
    """Open the workbench in the browser: look at studies, drag parameters, identify, see results."""
    from fmuid.errors import InputError
    from fmuid.files import is_folder
    from fmuid.processes import AVAILABLE
    from fmuid.simulation import start_server

    if (certificate is None) != (key is None):
        raise InputError("--certificate and --key go together: give both, PEM files")
    if AVAILABLE:
        start_server()  # it loads its code while this process loads its own
    from fmuid.apps.workbench import LOCAL, Certificate, Folder, Workbench, entry_file, start_browser
    from fmuid.reports.console.layout import show_notes

    study = None if is_folder(target) else target
    if study is not None and not study.is_file():
        raise InputError(f"{target}: there is no such study file or folder")
    shown = None if certificate is None or key is None else Certificate(certificate, key)
    bench = Workbench(
        Folder(target if study is None else study.parent), study, host=listen or LOCAL, port=port, certificate=shown
    )
    if listen is not None:
        show_notes(
            [
                f"other machines can reach this one at {listen}: whoever has the address below can run these studies "
                "and read the files of this folder, until it is ended; give it to nobody else"
            ]
        )

    def ready() -> None:
        print(bench.address, flush=True)
        if browser:
            start_browser(kept.enter_context(entry_file(bench)), refused)

    def refused() -> None:
        if bench.awaits_browser:
            show_notes(["No browser could be started. Open the address above by hand."])

    print("Ctrl-C ends the workbench; what it is running then is interrupted and saved.", flush=True)
    print("Until then this address opens it:", flush=True)
    with contextlib.ExitStack() as kept, contextlib.suppress(KeyboardInterrupt):  # how it is meant to end
        bench.run(ready)
    return DONE
