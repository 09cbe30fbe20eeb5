"""Write the messages of the topics into docs/messages.md: ``python -m tools.messages_page``.

Comments enclose each list: ``<!-- BatchMessage -->`` and ``<!-- end -->``. The rest of the page is kept.
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
    """Return the page with the lists of now.

    Raises
    ------
    KeyError
        If it has a place for messages that there are not.
    """
    lists = {kind.__name__: listed(kind) for kind in kinds()}
    text = PAGE.read_text(encoding="utf-8")
    return MARKED.sub(lambda found: f"<!-- {found[1]} -->\n\n{lists[found[1]]}\n\n<!-- end -->", text)


def kinds() -> Iterator[type[Message]]:
    """Yield all classes of messages."""
    for module in walk_packages(reports.__path__, "fmuid.reports."):
        import_module(module.name)
    yield from (each for each in Message.__subclasses__() if each.__module__.startswith("fmuid."))


def listed(kind: type[Message]) -> str:
    """Return the messages of a class that need an explanation, with it."""
    said: dict[str, list[str]] = {}
    for each in kind:
        text = f"*{_said(each.text)}*"
        if each.meaning and has_words(each) and text not in said.setdefault(each.meaning, []):
            said[each.meaning].append(text)
    return "\n".join(f"- {', '.join(texts)}: {meaning}" for meaning, texts in said.items() if texts)


def has_words(message: Message) -> bool:
    """Whether a message says more than what it is filled with."""
    return re.search(r"\w", re.sub(r"\{[^}]*\}", "", message.text)) is not None


def _said(text: str) -> str:
    """Return a template with an ellipsis for each value."""
    return capitalized(re.sub(r"\{[^}]*\}( ?\{[^}]*\})*", "…", text)).removesuffix(".")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
