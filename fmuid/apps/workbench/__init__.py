"""The workbench in the browser: studies, what-if, identification, results and batches of a folder."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
