"""Web page of a log in the local browser, for `seatrial view` and beside a run: server, decimation and intervals."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
