"""Console for tables and texts: the width of a terminal, and no limit of width elsewhere."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

UNLIMITED = 10_000  # columns of a console that is no terminal: more than any table needs
PROSE = 80  # columns of texts in a console without a limit


def make_console(stderr: bool = False) -> Console:
    """Return a console on stdout, or on stderr.

    If it is no terminal (a pipe or a file), its width is that of the environment variable COLUMNS, and without it there
    is no limit. The console of rich would have 80 columns there, and cut the cells of wide tables.
    """
    from rich.console import Console

    console = Console(highlight=False, stderr=stderr)
    if not console.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        console.width = UNLIMITED
    return console


def print_table(console: Console, table: Table, indent: int = 0) -> None:
    """Print a table, indented by a number of columns.

    On a terminal, cells that do not fit are cut as the columns of the table say. Elsewhere no cell is cut: long cells
    are continued on the next line if the console has a limit of width. The columns of the table are changed for this.
    """
    from rich.padding import Padding

    if not console.is_terminal:
        for column in table.columns:
            column.no_wrap, column.overflow, column.max_width = False, "fold", None
    console.print(Padding(table, (0, 0, 0, indent), expand=False))


def print_prose(console: Console, text: RenderableType) -> None:
    """Print a text, indented by one column and wrapped at the width of the console, without a limit at 80 columns."""
    from rich.padding import Padding

    console.print(Padding(text, (0, 1)), width=PROSE if console.width == UNLIMITED else None)
