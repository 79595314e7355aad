from .formats import export as export
