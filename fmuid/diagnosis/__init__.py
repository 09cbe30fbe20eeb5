"""Which fault explains the data: hypotheses beside the healthy model, decision, monitoring, design of tests."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
