"""Monte Carlo studies of the estimator: simulated replicates, bias and variance of estimates, coverage."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
