"""Reports of results: HTML pages with figures, formatted numbers, and tables. Only this package draws figures."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
