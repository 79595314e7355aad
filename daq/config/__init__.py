"""Configuration files: rig.toml and mission.toml to dataclasses and back."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
