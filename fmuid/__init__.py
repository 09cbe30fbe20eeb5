"""Identify the physical parameters of FMUs from measured data.

`__init__.pyi` lists the public names. Each is imported at its first use, which keeps ``import fmuid`` fast.
"""

from typing import Any

import lazy_loader

from fmuid.display_mixins import set_renderer


def _renderer() -> Any:
    from fmuid.reports.render import notebook  # imported when something is first shown

    return notebook


set_renderer(_renderer)
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
