"""Acquisition: a process that reads ports and writes the log, its watchdog, and its connection to the parent."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
