"""Monte Carlo studies of the estimator: recovery of known true values, and coverage of its intervals."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
