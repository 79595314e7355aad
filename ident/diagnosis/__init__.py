"""Diagnosis of missing effects: score tests, refits, selection, attribution and importance of effects."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
