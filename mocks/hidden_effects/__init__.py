"""Catalogue of hidden effects of the mock boat and bench: physics that the plant has and the nominal model lacks."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
