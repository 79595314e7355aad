"""Results of the commands as data: the types of result.json and of its tables, their builders, the sentences about fits
and diagnoses, and the reader and writer of the file. Report pages and tables for the terminal are in report.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
