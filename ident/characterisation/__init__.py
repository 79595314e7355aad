"""Numerical characterisation of components: thrusters on the bench, static thrust curves, load cells, sensor noise.

The commands that use it, `seatrial ident thruster` and `seatrial ident noise`, are in workflows.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
