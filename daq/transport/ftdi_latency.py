"""The latency timer of FTDI adapters: they buffer bytes for 16 ms by default.

Source: FTDI AN232B-04, "Data throughput, latency and handshaking"; Linux drivers/usb/serial/ftdi_sio.c.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

SYSFS = Path("/sys/bus/usb-serial/devices")
VENDOR = 0x0403
NAMES = ("ttyUSB", "cu.usbserial", "tty.usbserial")  # what the ports of such adapters are called
UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


def usb_vendor(path: str) -> int | None:
    """USB vendor id of the adapter behind a serial port; None where the system does not report it."""
    from serial.tools import list_ports  # takes a while to import, and hardly any port needs it

    real = os.path.realpath(path)
    return next((port.vid for port in list_ports.comports() if port.device in (path, real)), None)


def set_latency_timer(path: str, sysfs: Path = SYSFS, vendor: Callable[[str], int | None] = usb_vendor) -> str:
    """Set the adapter behind a serial port to 1 ms; returns a hint where that fails, else an empty string.

    Most ports are no FTDI adapters, or have been set already: nothing to do.
    """
    name = Path(os.path.realpath(path)).name
    timer = sysfs / name / "latency_timer"
    if not timer.exists():
        if name.startswith(NAMES) and vendor(path) == VENDOR:
            return "an FTDI adapter that keeps bytes for up to 16 ms, and this system has no latency_timer to change it"
        return ""
    held = "?"
    try:
        held = timer.read_text(encoding="ascii").strip()
        if held not in ("0", "1"):
            timer.write_text("1", encoding="ascii")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        return f"the adapter keeps bytes for up to {held} ms ({why}): echo 1 | sudo tee {timer}"
    return ""
