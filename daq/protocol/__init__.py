"""Wire protocols without I/O: decoders of bytes to samples and encoders of commands to bytes, one protocol per file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
