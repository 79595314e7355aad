"""Model structures: thruster, surge, yaw, 3-DOF horizontal, Nomoto, kinematic (measured attitude), user-defined."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
