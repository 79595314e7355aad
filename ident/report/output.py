"""What people see of a result: a page that opens offline, and a few lines in the terminal. The only plotting."""

from ident.report.page import write_report
from ident.report.terminal import print_result

__all__ = ["print_result", "write_report"]
