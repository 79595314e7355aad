"""Diagnosis: score tests for missing effects, refits, choice of an effect, its alternatives and importance."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
