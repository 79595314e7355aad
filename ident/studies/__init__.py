"""Monte Carlo studies of the estimator: cases with known true values, their replicates, bias, variance and coverage.
The command `ident study` is in workflows.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
