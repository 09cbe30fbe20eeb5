"""The command ``fmuid``; its commands are in the modules beside it.

They parse, call and print: no maths, and nothing heavy is imported before a command needs it.
"""

from __future__ import annotations

import atexit
import copy
import gc
import inspect
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

# Objects between two looks for garbage in cycles, and how many of these before a longer one: there is next to none, and
# with Python's own numbers the looking is a tenth of the start.
COLLECTIONS = 100_000, 20, 20

app = typer.Typer(
    name="fmuid",
    help="Identify the physical parameters of FMUs from measured data.",
    epilog="Exit code: 0 done, 1 ran but did not succeed (such as not converged), 2 wrong input.",
    add_completion=False,
    rich_markup_mode=None,  # rich takes longer to import than all else that help needs
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
    """Identify the physical parameters of FMUs from measured data."""


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
    studies.design,
    results.predict,
    results.compare,
    results.apply,
    models.export,
    studies.workbench,
):
    app.command(short_help=inspect.getdoc(command))(command)  # whole, where typer would cut it


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code; whatever is wrong with the input is one sentence on stderr."""
    open_descriptors()
    gc.set_threshold(*COLLECTIONS)
    atexit.register(gc.freeze)  # or Python looks through all that was loaded once more before it ends: 0.3 s
    with handled():
        code = run(arguments)
    sys.exit(code)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments
        As typed after ``fmuid``; default: those of the process.
    """
    given = sys.argv[1:] if arguments is None else list(arguments)
    with guarded() as output, noted() as written:
        code = _ran(given)
        output.flush()
        if output.lost is not None:
            places = sorted({str(path.parent) for path in written})
            kept = f"; the files are written, in {listed(places)}" if places else ""
            return _refuse(f"the standard output: {output.lost.strerror or output.lost}{kept}", code or NOT_SUCCEEDED)
        return code


def _ran(given: Sequence[str]) -> int:
    """Run a command and return its exit code; an error is a sentence."""
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
    except OSError as error:  # a full disk wherever a library writes
        place = f"{error.filename}: " if error.filename else ""
        return _refuse(f"{place}{error.strerror or error}", NOT_SUCCEEDED)
    if code == _TYPER_INTERRUPTED:
        return _refuse("interrupted", NOT_SUCCEEDED)
    return code if isinstance(code, int) else DONE


def _with_command(given: Sequence[str]) -> typer.Typer:
    """Return the command line with the one command that is asked for, where it is clear: typer builds all it has."""
    named = [each for each in app.registered_commands if given and given[0] == getattr(each.callback, "__name__", "")]
    narrow = copy.copy(app)
    narrow.registered_commands = named or app.registered_commands
    return narrow


# What typer returns for Ctrl-C where it does not raise Abort.
_TYPER_INTERRUPTED = 130
# Click's exception of wrong usage, wherever this version of typer keeps click.
_USAGE_ERROR: Any = typer.BadParameter.__mro__[2]


def _refuse(sentence: str, code: int) -> int:
    print("error: " + visible(" ".join(sentence.split())), file=sys.stderr)
    return code
