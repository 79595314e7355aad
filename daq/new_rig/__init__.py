"""New rigs: text of a rig file and its checklist, from answers, options and discovered devices (`seatrial init`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
