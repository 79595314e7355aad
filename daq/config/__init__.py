"""Configuration files: readers of rig.toml and mission.toml, and the writer of mission.toml."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
