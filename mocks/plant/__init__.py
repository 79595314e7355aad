"""Simulated plants without sensors: equations of motion of boat and bench, hull, thruster and weather, and the hooks of
hidden effects.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
