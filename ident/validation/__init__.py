"""Model validation: prediction errors, calibration of prediction intervals, and whiteness of residuals. Fits are in
estimation, and searches for missing effects in diagnosis.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
