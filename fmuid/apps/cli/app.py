"""The command ``fmuid``. Commands parse, call and render; heavy imports wait for them."""

from __future__ import annotations

import atexit
import copy
import gc
import inspect
import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from fmuid.apps.cli import batch, models, results, studies
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, WRONG_INPUT, changed_option
from fmuid.apps.cli.signals import guarded, handled, open_descriptors
from fmuid.errors import FmuidError, InputError
from fmuid.files import noted
from fmuid.formatting import listed, visible
from fmuid.version import __version__

COMPLETION = "_FMUID_COMPLETE"  # environment variable by which a shell asks for completions

app = typer.Typer(
    name="fmuid",
    help="Identify physical parameters of FMUs from measured data.",
    epilog="Exit codes: 0 success, 1 no success (not converged, fault found, doubt with --strict), 2 wrong input.",
    add_completion=False,
    rich_markup_mode=None,  # the import of rich is slow
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        print(f"fmuid {__version__}")
        raise typer.Exit


@app.callback()
def fmuid(
    version: Annotated[  # acts through its callback
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Identify physical parameters of FMUs from measured data."""


def completion(
    shell: Annotated[str, typer.Argument(metavar="SHELL", help="bash, zsh or fish.", show_default=False)],
) -> int:
    """Print the completion script of a shell."""
    from typer.completion import get_completion_script  # type: ignore[attr-defined]

    if shell not in ("bash", "zsh", "fish"):
        raise InputError(f"{shell}: no completion for this shell. Choose bash, zsh or fish.")
    print(get_completion_script(prog_name="fmuid", complete_var=COMPLETION, shell=shell))
    return DONE


for command in (
    models.info,
    models.validate,
    models.init,
    models.schema,
    studies.simulate,
    studies.identify,
    studies.diagnose,
    studies.monitor,
    batch.batch,
    results.report,
    studies.baseline,
    studies.design,
    results.predict,
    results.compare,
    results.apply,
    models.export,
    studies.workbench,
    completion,
):
    app.command(short_help=inspect.getdoc(command))(command)  # typer would cut it


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    open_descriptors()
    gc.set_threshold(100_000, 20, 20)  # cycles are rare; the defaults cost a tenth of the start
    atexit.register(gc.freeze)  # saves 0.3 s at exit
    with handled():
        code = run(arguments)
    sys.exit(code)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (default: this process's arguments); return its exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    with guarded() as output, noted() as written:
        code = _ran(given)
        output.flush()
        if output.lost is not None:
            places = sorted({str(path.parent) for path in written})
            kept = f". Files are written to {listed(places)}" if places else ""
            return _refuse(f"the standard output: {output.lost.strerror or output.lost}{kept}", code or NOT_SUCCEEDED)
        return code


def _ran(given: Sequence[str]) -> int:
    try:
        code: Any = _with_command(given)(given or ["--help"], standalone_mode=False, prog_name="fmuid")
    except InputError as error:
        return _refuse(str(error), WRONG_INPUT)
    except FmuidError as error:
        return _refuse(str(error), NOT_SUCCEEDED)
    except _USAGE_ERROR as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "fmuid"
        if changed := changed_option(given):
            return _refuse(f"{command}: {changed} (see {command} --help)", WRONG_INPUT)
        return _refuse(
            f"{command}: {error.format_message().rstrip('.?').replace('. ', '; ')} (see {command} --help)", WRONG_INPUT
        )
    except (KeyboardInterrupt, typer.Abort):
        return _refuse("interrupted", NOT_SUCCEEDED)
    except OSError as error:  # such as a full disk
        place = f"{error.filename}: " if error.filename else ""
        return _refuse(f"{place}{error.strerror or error}", NOT_SUCCEEDED)
    if code == _TYPER_INTERRUPTED:
        return _refuse("interrupted", NOT_SUCCEEDED)
    return code if isinstance(code, int) else DONE


def _with_command(given: Sequence[str]) -> typer.Typer:
    """Return an app with the requested command only: typer builds all."""
    if COMPLETION in os.environ:
        from typer.completion import completion_init  # type: ignore[attr-defined]

        completion_init()
        return app
    named = [each for each in app.registered_commands if given and given[0] == getattr(each.callback, "__name__", "")]
    narrow = copy.copy(app)
    narrow.registered_commands = named or app.registered_commands
    return narrow


_TYPER_INTERRUPTED = 130  # typer's exit code for Ctrl-C without Abort
_USAGE_ERROR: Any = typer.BadParameter.__mro__[2]  # Click's usage error, wherever typer keeps click


def _refuse(sentence: str, code: int) -> int:
    print("error: " + visible(" ".join(sentence.split())), file=sys.stderr)
    return code
