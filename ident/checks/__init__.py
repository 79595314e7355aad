"""Checks of a log before any fit: sensors against each other, shafts against commands, motion against thrust."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
