"""Check that all data of an HDF5 file is in the file itself, before any of the data is read.

HDF5 can place data in other files: by soft and external links, by external storage and by virtual datasets. A file from
another person could name any file of this computer. The import would then copy that file into a log, and the log may be
shared. MATLAB does not write such files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from seatrial.daq.errors import SeatrialError, printable


def refuse_data_of_other_files(path: Path, file: Any) -> None:
    """Raise SeatrialError if an HDF5 file refers to another file, or has two links to the same object.

    Parameters
    ----------
    path
        Name of the file, for the message.
    file : h5py.File
        The open file.

    Raises
    ------
    SeatrialError
        If an object is a link to another place, a second link, or has its data in another file.

    Notes
    -----
    A file from another person could name any file of this computer. An object with two links could contain itself, or
    be read any number of times.
    """
    import h5py

    layouts = (h5py.h5d.CONTIGUOUS, h5py.h5d.CHUNKED, h5py.h5d.COMPACT)
    known = {h5py.h5o.get_info(file.id).addr}
    groups = [file]
    while groups:
        group = groups.pop()
        for name in group:
            place = f"{path}: {printable(f'{group.name.rstrip(chr(47))}/{name}')}"
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise SeatrialError(
                    f"{place} is a link to another place, and only data in the file itself is imported; save the data "
                    "in the file itself"
                )
            node = group[name]
            address = h5py.h5o.get_info(node.id).addr
            if address in known:
                raise SeatrialError(f"{place} is a second link to the same object; save the file again with MATLAB")
            known.add(address)
            if isinstance(node, h5py.Group):
                groups.append(node)
            elif isinstance(node, h5py.Dataset):
                properties = node.id.get_create_plist()
                if properties.get_layout() not in layouts or properties.get_external_count():
                    raise SeatrialError(
                        f"{place} has its data in another file, and only data in the file itself is imported; save the "
                        "data in the file itself"
                    )
