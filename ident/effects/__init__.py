"""Catalogue of effects that a nominal model may lack, one file each, by physical origin."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
