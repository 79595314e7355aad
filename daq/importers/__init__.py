"""Importers of foreign logs: CSV, MAVLink, DataFlash, ROS 2, ULog, raw captures."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
