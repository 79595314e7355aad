"""Characterisation of components: thrusters on the bench, static thrust curves, and sensor noise."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
