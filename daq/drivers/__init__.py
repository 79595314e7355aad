"""Device drivers: what a port sends besides listening: set-points, requests, heartbeats, shutdown."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
