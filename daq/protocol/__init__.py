"""Wire protocols, sans I/O: bytes to samples and commands to bytes, one protocol a file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
