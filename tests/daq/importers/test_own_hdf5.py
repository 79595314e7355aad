"""Tests of MATLAB files that refer to data elsewhere: a local file must never become part of a log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.columnar import read_matlab
from seatrial.daq.importers.table import SourceOptions


def external_storage(file: h5py.File, secret: Path) -> None:
    file.create_dataset("x", (20,), np.uint8, external=[(str(secret), 0, 20)])


def external_link(file: h5py.File, secret: Path) -> None:
    file["x"] = h5py.ExternalLink(str(secret.with_suffix(".h5")), "/x")


def virtual_dataset(file: h5py.File, secret: Path) -> None:
    layout = h5py.VirtualLayout((20,), np.float64)
    layout[:] = h5py.VirtualSource(str(secret.with_suffix(".h5")), "x", (20,))
    file.create_virtual_dataset("x", layout)


def soft_link(file: h5py.File, secret: Path) -> None:
    file["x"] = h5py.SoftLink("/t")


def nested_external_storage(file: h5py.File, secret: Path) -> None:
    external_storage(file.create_group("#refs#").create_group("a"), secret)


def group_in_itself(file: h5py.File, secret: Path) -> None:
    inner = file.create_group("a")
    inner["a"] = inner


def groups_that_multiply(file: h5py.File, secret: Path) -> None:
    inner = file.create_group("g0")
    inner["x"] = np.arange(20.0)
    for k in range(1, 9):
        outer = file.create_group(f"g{k}")
        for name in "abcdefgh":
            outer[name] = inner
        inner = outer


MAKERS: list[Callable[[h5py.File, Path], None]] = [
    external_storage,
    external_link,
    virtual_dataset,
    soft_link,
    nested_external_storage,
    group_in_itself,
    groups_that_multiply,
]


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
def test_data_elsewhere_is_refused_in_one_line(tmp_path: Path, make: Callable[[h5py.File, Path], None]) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(b"password = 'abcdefghij'\n")
    with h5py.File(secret.with_suffix(".h5"), "w") as file:
        file["x"] = np.arange(20.0)
    with h5py.File(tmp_path / "run.mat", "w") as file:
        file["t"] = np.arange(20.0)
        make(file, secret)
    with pytest.raises(SeatrialError, match=r"run\.mat: /.*(another|second)") as caught:
        read_matlab(tmp_path / "run.mat", SourceOptions())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("how", [{}, {"chunks": (5,), "compression": "gzip"}], ids=["contiguous", "chunked"])
def test_data_inside_the_file_is_read(tmp_path: Path, how: dict[str, object]) -> None:
    with h5py.File(tmp_path / "run.mat", "w") as file:
        file["t"] = np.arange(20.0)
        file.create_group("s").create_dataset("x", data=np.arange(20.0), **how)
    tables = read_matlab(tmp_path / "run.mat", SourceOptions())
    assert {name for table in tables for name in table.names} == {"t", "x"}
