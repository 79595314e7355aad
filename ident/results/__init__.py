"""Results of the commands as data, and their file result.json.

The modules have the types of results and tables, builders of the results, sentences about fits and diagnoses, and the
reader and writer of the file. Report pages and tables for the terminal are in ``seatrial.ident.report``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
