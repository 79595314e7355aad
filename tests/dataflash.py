"""Writer of DataFlash logs of ArduPilot, by the layout of their messages. seatrial does not write such logs."""

from __future__ import annotations

import struct

# A DataFlash log consists of messages with the header a3 95 and a number. FMT (128) describes the others.
FMT = struct.Struct("<BB4s16s64s")
FORMATS = {
    "ATT": (1, "Qccccccff", "<Q6h2f", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw"),
    "RCOU": (2, "QHHH", "<Q3H", "TimeUS,C1,C2,C3"),
    "GPS": (
        3, "QBBIHBcLLefffffB", "<QBBIHBhiii5fB",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,YawE,U",
    ),
    "BAT": (4, "QBfffffcHB", "<QBfffffhHB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct"),
    "MODE": (5, "QMBB", "<QBBB", "TimeUS,Mode,ModeNum,Rsn"),
    "PARM": (6, "QNf", "<Q16sf", "TimeUS,Name,Value"), "ARM": (7, "QB", "<QB", "TimeUS,ArmState"),
    "EV": (8, "QB", "<QB", "TimeUS,Id"), "ERR": (9, "QBB", "<QBB", "TimeUS,Subsys,ECode"),
    "IMU": (10, "QBffffff", "<QB6f", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ESC": (13, "QBffff", "<QB4f", "TimeUS,Instance,RPM,Volt,Curr,Temp"),
    "GPA": (11, "QBI", "<QBI", "TimeUS,I,SMS"), "MSG": (12, "QZ", "<Q64s", "TimeUS,Message"),
}  # fmt: skip


def dataflash_head() -> bytes:
    """Return the messages FMT that describe all other messages."""
    return b"".join(
        b"\xa3\x95\x80" + FMT.pack(number, 3 + struct.calcsize(code), name.encode(), form.encode(), columns.encode())
        for name, (number, form, code, columns) in FORMATS.items()
    )


def dataflash_message(name: str, *values: float | bytes) -> bytes:
    """Return a message of one of `FORMATS`."""
    number, _, code, _ = FORMATS[name]
    return b"\xa3\x95" + bytes([number]) + struct.pack(code, *values)
