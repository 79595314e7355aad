"""Parallel work: many independent tasks on the cores of a computer or on a Dask or Ray cluster, and their table."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
