"""Optimal experiment design: Fisher information, optimality criteria, search of input signals, discrimination. The
command `mission design` is in workflows.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
