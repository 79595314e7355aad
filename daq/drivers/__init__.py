"""Device drivers: the bytes that a port sends, which are set-points, requests, heartbeats and the shutdown."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
