"""Where models that run and numerics meet: problems whose predictors run FMUs, and searches that check them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
