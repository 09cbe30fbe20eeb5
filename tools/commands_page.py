"""Write the help of all commands as a page: ``python -m tools.commands_page > docs/commands.md``."""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any, get_args, get_type_hints

from typer.models import ArgumentInfo, OptionInfo

from fmuid.apps.cli.app import app
from fmuid.apps.cli.options import SCREEN_OPTIONS

SHARED = 3
"""Commands with an argument or option before it is listed once for all."""

HEAD = """# The commands

`fmuid COMMAND --help` prints the same. `fmuid --version` prints the version.

Exit codes: 0 done; 1 ran without success, such as not converged, or a fault found; 2 wrong input.

Results go to standard output. Notes, warnings and progress go to standard error.

## Output

`fmuid identify` prints the verdict, the estimates, at most five lines and one remedy. Progress is one live line on a
terminal. It is absent in pipes, except with `--verbose`. Tables have the width of `COLUMNS`; `NO_COLOR` removes colors.

`info`, `validate`, `simulate`, `identify`, `diagnose`, `monitor`, `batch`, `design`, `predict` and `compare` have these
options:

{options}

## Shell completion

    fmuid completion bash > ~/.local/share/bash-completion/completions/fmuid
    fmuid completion zsh > ~/.zfunc/_fmuid         # a folder of fpath
    fmuid completion fish > ~/.config/fish/completions/fmuid.fish

## Arguments and options of several commands

Each command lists in its last line which of these options it has.

{shared}
"""


def page() -> str:
    """Return the page, in Markdown."""
    commands = [each.callback for each in app.registered_commands if each.callback is not None]
    infos = {name: get_args(kind)[1] for name, kind in SCREEN_OPTIONS.items()}
    options = "\n".join(f"- `--{name}`: {info.help}" for name, info in infos.items())
    counts = Counter(row for each in commands for row in _rows(each).values())
    shared = [row for row, count in counts.items() if count >= SHARED]
    sections = [_section(each, shared) for each in commands]
    return "\n".join([HEAD.format(options=options, shared="\n".join(shared)), *sections])


def _name(command: Callable[..., Any]) -> str:
    return command.__name__.rstrip("_")


def _section(command: Callable[..., Any], shared: list[str]) -> str:
    """Return heading, usage and options of a command; shared ones by name only."""
    rows = _rows(command)
    places = [word for word in rows if not word.startswith("-")]
    usage = " ".join(["    fmuid", _name(command), *places, *(["[OPTIONS]"] if len(places) < len(rows) else [])])
    own = [row for row in rows.values() if row not in shared]
    also = ", ".join(f"`{word}`" for word, row in rows.items() if row in shared and word.startswith("-"))
    last = [f"{'Also' if own else 'Has'} {also}.", ""] if also else []
    head = [f"## fmuid {_name(command)}", "", _text(command.__doc__), "", usage, ""]
    return "\n".join([*head, *own, *([""] if own else []), *last])


def _rows(command: Callable[..., Any]) -> dict[str, str]:
    """Return a line of the page for each argument and option of a command."""
    return {
        each[0]: f"- {_shown(*each)}: {_text(each[1].help)}{_default(each[1], each[3])}"
        for each in _parameters(command)
    }


def _parameters(command: Callable[..., Any]) -> Iterator[tuple[str, ArgumentInfo | OptionInfo, Any, Any]]:
    """Yield of each parameter its place or option, what is said of it, its type and its default."""
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        if name in SCREEN_OPTIONS:
            continue
        kind, info = get_args(hints[name])[:2]
        several = "..." if "list" in str(kind) else ""
        if isinstance(info, ArgumentInfo):
            word = f"{(info.metavar or name.upper()).strip('[]')}{several}"
            yield word if parameter.default is inspect.Parameter.empty else f"[{word}]", info, kind, parameter.default
        else:
            said = [each for each in (info.default, *(info.param_decls or ())) if isinstance(each, str)]
            words = said or [f"--{name.strip('_').replace('_', '-')}"]
            yield ", ".join(sorted(words, key=len)), info, kind, parameter.default


def _shown(words: str, info: ArgumentInfo | OptionInfo, kind: Any, _: Any) -> str:
    """Return a place or an option with its values; of two words for yes and no the first is the default."""
    if isinstance(info, ArgumentInfo) or kind is bool:
        return f"`{words}`"
    choices = next((each for each in (kind, *get_args(kind)) if inspect.isclass(each) and issubclass(each, Enum)), None)
    value = " or ".join(each.value for each in choices) if choices else info.metavar or "VALUE"
    return f"`{words} {value}`"


def _default(info: ArgumentInfo | OptionInfo, default: Any) -> str:
    if default is inspect.Parameter.empty:
        return "" if isinstance(info, ArgumentInfo) else " Required."
    return "" if default in (None, False, True, "") else f" Default: `{getattr(default, 'value', default)}`."


def _text(text: str | None) -> str:
    return " ".join((text or "").split())


if __name__ == "__main__":
    print(page(), end="")
