"""Tools on ports and logs: discovery, live table, live ROS 2, info, export, replay."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
