"""Write the messages of the topics as tables into docs/messages.md: ``python -m tools.messages_page``.

Comments enclose each table: ``<!-- BatchMessage -->`` and ``<!-- end -->``. The rest of the page is kept.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

from fmuid import reports
from fmuid.reports.document import Message, capitalized

PAGE = Path(__file__).parents[1] / "docs" / "messages.md"
MARKED = re.compile(r"<!-- (\w+Message) -->\n.*?<!-- end -->", re.DOTALL)


def page() -> str:
    """Return the page, with the tables that belong there now.

    Raises
    ------
    KeyError
        If it has a place for messages that there are not.
    """
    tables = {kind.__name__: table(kind) for kind in kinds()}
    text = PAGE.read_text(encoding="utf-8")
    return MARKED.sub(lambda found: f"<!-- {found[1]} -->\n\n{tables[found[1]]}\n\n<!-- end -->", text)


def kinds() -> Iterator[type[Message]]:
    """Yield all classes of messages."""
    for module in walk_packages(reports.__path__, "fmuid.reports."):
        import_module(module.name)
    yield from (each for each in Message.__subclasses__() if each.__module__.startswith("fmuid."))


def table(kind: type[Message]) -> str:
    """Return the messages of a class as a table; those that are filled with a whole sentence are none of their own."""
    rows = [(f"*{_said(each.text)}*", each.meaning, _open(each.remedy)) for each in kind if has_words(each)]
    heads = ("it says", "meaning", "what to do") if any(remedy for *_, remedy in rows) else ("it says", "meaning")
    told = [heads, ("---",) * len(heads), *(row[: len(heads)] for row in rows)]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in told]
    lines[1] = "|---" * len(heads) + "|"
    return "\n".join(re.sub(r"\|  (?=\|)", "| ", line) for line in lines)


def has_words(message: Message) -> bool:
    """Whether a message says more than what it is filled with."""
    return re.search(r"\w", re.sub(r"\{[^}]*\}", "", message.text)) is not None


def _open(text: str) -> str:
    return re.sub(r"\{[^}]*\}( ?\{[^}]*\})*", "…", text)


def _said(text: str) -> str:
    """Return a template with an ellipsis for each value."""
    return capitalized(_open(text))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
