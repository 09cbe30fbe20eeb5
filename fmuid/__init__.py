"""Identify the physical parameters of models packaged as FMUs from tables of measurements.

Everything public is here (`__init__.pyi` lists it); what a name needs is imported when the name is first used, so that
``import fmuid`` is fast. Each package below has a face of the same kind.
"""

import lazy_loader

from fmuid.display_mixins import shown_by

shown_by("fmuid.reports.render.notebook")  # imported when a notebook first shows something
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
