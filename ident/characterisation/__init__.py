"""Numerical characterisation of components: thrusters on the bench, static thrust curves, load cells and sensor noise.

The commands `ident thruster` and `ident noise`, which call it, are in workflows.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
