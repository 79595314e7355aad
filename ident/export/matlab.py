"""MATLAB files of matrices with names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.daq.log import import_library


def cell_array(texts: Iterable[str]) -> NDArray[np.object_]:
    """Return texts as an array of objects, which becomes a cell array."""
    return np.array(list(texts), dtype=object)


def check_mat_name(path: Path) -> None:
    """Raise SeatrialError if the name of a MATLAB file does not end in .mat."""
    if path.suffix != ".mat":
        raise SeatrialError(f"{path}: MATLAB loads files whose name ends in .mat; give such a name")


def write_mat(path: Path, variables: Mapping[str, Any], force: bool) -> None:
    """Write variables by name to a MATLAB file. Vectors become columns.

    Raises
    ------
    SeatrialError
        If the file exists and ``force`` is False, or if scipy is not installed.
    """
    content = BytesIO()
    import_library("scipy.io").savemat(content, variables, long_field_names=True, oned_as="column")
    write_output(path, content.getvalue(), force)
