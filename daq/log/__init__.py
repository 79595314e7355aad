"""Logs: writing samples to MCAP files and reading them back, segments, recovery and provenance."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
