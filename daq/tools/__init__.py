"""Tools for ports and logs: discovery of devices, live table, live ROS 2, and info, export and replay of logs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
