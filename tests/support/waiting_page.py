"""A page that waits, in the loop of the server, until it is told to go on."""

import threading
from typing import Any

PATIENCE = 60.0
begun, go = threading.Event(), threading.Event()


def build(doc: Any, _workbench: object) -> None:
    """Fill a document."""
    from bokeh.models import TextInput

    from fmuid.apps.workbench.page_layout import dress

    typed = TextInput(value="", name="typed", title="")
    typed.on_change("value", lambda _attr, _old, _new: _wait(typed))
    doc.add_root(typed)
    dress(doc, "waiting", [("<p>A page.</p>", "typed")], "bokeh-widgets")


def _wait(typed: Any) -> None:
    begun.set()
    assert go.wait(PATIENCE)
    typed.title += "."
