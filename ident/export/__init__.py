"""Export of a fitted model as source code or parameters for other programs: Python, CasADi, C, ROS 2, FMI, Gazebo."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
