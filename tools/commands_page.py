"""Write the help of all commands as a page: ``python -m tools.commands_page > docs/commands.md``."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any, get_args, get_type_hints

from typer.models import ArgumentInfo, OptionInfo

from fmuid.apps.cli.app import app
from fmuid.apps.cli.options import SCREEN_OPTIONS

OPTIONS_HEAD = "| option | effect |\n|---|---|"

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

## All commands
"""


def page() -> str:
    """Return the page, in Markdown."""
    commands = [each.callback for each in app.registered_commands if each.callback is not None]
    rows = [f"| [`{_name(each)}`](#fmuid-{_name(each)}) | {_text(each.__doc__)} |" for each in commands]
    infos = {name: get_args(kind)[1] for name, kind in SCREEN_OPTIONS.items()}
    options = "\n".join([OPTIONS_HEAD, *(f"| `--{name}` | {info.help} |" for name, info in infos.items())])
    return "\n".join(
        [HEAD.format(options=options), "| command | effect |", "|---|---|", *rows, "", *map(_section, commands)]
    )


def _name(command: Callable[..., Any]) -> str:
    return command.__name__.rstrip("_")


def _section(command: Callable[..., Any]) -> str:
    taken = list(_parameters(command))
    places = [word for word, info, *_ in taken if isinstance(info, ArgumentInfo)]
    rows = [f"| {_shown(*each)} | {_text(each[1].help)} | {_default(each[3])} |" for each in taken]
    head = [f"## fmuid {_name(command)}", "", _text(command.__doc__), ""]
    usage = " ".join(["    fmuid", _name(command), *places, *(["[OPTIONS]"] if len(places) < len(taken) else [])])
    return "\n".join(
        [*head, usage, "", *(["| argument | meaning | default |", "|---|---|---|", *rows, ""] if rows else [])]
    )


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


def _default(default: Any) -> str:
    if default is inspect.Parameter.empty:
        return "must be given"
    return "" if default in (None, False, True, "") else f"`{getattr(default, 'value', default)}`"


def _text(text: str | None) -> str:
    return " ".join((text or "").split()).replace("|", "\\|")


if __name__ == "__main__":
    print(page(), end="")
