"""Latency timer of FTDI serial adapters, which delay received bytes by up to 16 ms by default.

Source: FTDI AN232B-04, "Data throughput, latency and handshaking"; Linux drivers/usb/serial/ftdi_sio.c.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

SYSFS = Path("/sys/bus/usb-serial/devices")
VENDOR = 0x0403  # USB vendor id of FTDI
NAMES = ("ttyUSB", "cu.usbserial", "tty.usbserial")  # beginnings of the port names of FTDI adapters
UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


def usb_vendor(path: str) -> int | None:
    """Return the USB vendor id of the adapter behind a serial port, or None if the system does not report it.

    `path` is the device file, or a symbolic link to it.
    """
    from serial.tools import list_ports  # imported here because the import is slow and few ports need it

    real = os.path.realpath(path)
    return next((port.vid for port in list_ports.comports() if port.device in (path, real)), None)


def set_latency_timer(path: str, sysfs: Path = SYSFS, vendor: Callable[[str], int | None] = usb_vendor) -> str:
    """Set the latency timer of the adapter behind a serial port to 1 ms. A timer of 0 or 1 ms is not changed.

    Parameters
    ----------
    path
        Path of the serial port.
    sysfs
        Folder in which the kernel lists serial adapters.
    vendor
        Function that returns the USB vendor id of a port.

    Returns
    -------
    str
        A hint for the user if the timer cannot be set, or if an FTDI adapter has none in this system. Empty if it is
        set, or if the port is not an FTDI adapter.
    """
    name = Path(os.path.realpath(path)).name
    timer = sysfs / name / "latency_timer"
    if not timer.exists():
        if name.startswith(NAMES) and vendor(path) == VENDOR:
            text = "the FTDI adapter delays bytes by up to 16 ms, and this system has no latency_timer to change it"
            return f"{text}; use another adapter, if this delay matters"
        return ""
    delay_ms = "?"
    try:
        delay_ms = timer.read_text(encoding="ascii").strip()
        if delay_ms not in ("0", "1"):
            timer.write_text("1", encoding="ascii")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        return f"the adapter delays bytes by up to {delay_ms} ms ({why}); to set 1 ms: echo 1 | sudo tee {timer}"
    return ""
