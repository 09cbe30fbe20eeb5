"""A page of the workbench with one widget."""

from typing import Any


def build(doc: Any, _workbench: object) -> None:
    """Fill a document."""
    from bokeh.models import Div

    from fmuid.apps.workbench.page_layout import dress

    doc.add_root(Div(text="plain", name="plain"))
    dress(doc, "plain", [("<p>A page.</p>", "plain")], "bokeh-widgets")
