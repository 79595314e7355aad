"""Text tables that numpy reads give the same numbers and line numbers as the reader of cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.table import TextStyle
from seatrial.daq.importers.text_table import TextTable


def table(path: Path, text: str, *, by_cells: bool = False) -> TextTable:
    """Return the table of a text, read as usual or by the reader of cells."""
    path.write_bytes(text.encode())
    with pytest.MonkeyPatch.context() as patch:
        if by_cells:
            patch.setattr(TextTable, "_read_numbers", lambda _: False)
        return TextTable(path, TextStyle())


@pytest.mark.parametrize(
    "text",
    [
        "t,x\n0,1\n0.1,-2.5e-3\n",
        "t,x\r\n0,1\r\n1,2\r\n",
        "t,x\r0,1\r1,2\r",
        "\ufefft,x\n 0 , 1\n1,nan",
        "t,x\n0,1\n\n1,2\n",  # a blank line
        "t,x\n0,\n1,2\n",  # an empty cell
        "t,x\ns,m\n0,1\n1,2\n",  # units
        "t,x\n0,1\nt,x\n1,2\n",  # the header again
        "t,x,\n0,1\n1,2\n",  # a separator at the end of the header
        '"t","x"\n"0","1"\n"1","2"\n',
    ],
)
def test_numbers_and_line_numbers_equal_the_reader_of_cells(tmp_path: Path, text: str) -> None:
    found, expected = table(tmp_path / "a.csv", text), table(tmp_path / "b.csv", text, by_cells=True)
    assert found.names == expected.names
    assert found.lines == expected.lines
    for name in ("t", "x"):
        np.testing.assert_array_equal(found.numbers(name), expected.numbers(name))


def test_text_of_a_numeric_table_is_as_written(tmp_path: Path) -> None:
    found = table(tmp_path / "a.csv", "t,x\n0,1.50\n1,2.00\n")
    assert found.text("x") == ["1.50", "2.00"]
    assert found.numbers("x").tolist() == [1.5, 2.0]


@pytest.mark.parametrize("cell", ["1_0", "inf", "0x10", "one"])
def test_error_names_the_line_of_a_cell_without_a_finite_number(tmp_path: Path, cell: str) -> None:
    with pytest.raises(SeatrialError, match=rf"line 3, column 'x': '{cell}' is not a (finite )?number"):
        table(tmp_path / "a.csv", f"t,x\n0,1\n1,{cell}\n2,3\n").numbers("x")
