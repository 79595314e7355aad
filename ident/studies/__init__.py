"""Monte Carlo studies: does the estimator recover known truth with calibrated intervals?"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
