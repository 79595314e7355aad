"""Ports of the mocks, which carry the bytes to the host: ptys, and UDP and TCP sockets on loopback."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
