"""Results of the commands as data: types and table rows of result.json, their writer, and the sentences about fits and
diagnoses. Pages and terminal tables are in report.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
