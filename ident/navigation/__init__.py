"""Navigation with a fitted model: filtered and smoothed states along a record, and position errors in GNSS outages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
