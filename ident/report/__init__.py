"""Reports: HTML pages, figures, formatted numbers and terminal tables of results. No other package draws figures."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
