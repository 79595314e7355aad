"""The compiled engine: extended Kalman filters, their adjoints and simulators, from CasADi graphs to machine code.

A kernel is a program that runs over all rows (instants) of a record. A plan describes a kernel before compilation, as a
list of stages: the steps of the computation in one row, for example the update of a filter by one sensor.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
