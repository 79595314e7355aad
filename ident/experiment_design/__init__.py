"""Optimal experiment design: Fisher information, optimality criteria, input design, and model discrimination."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
