"""Reference values of MIP packets, read by the library of their maker.

`python -m tests.golden.mip_oracle` writes docs/data/mip-oracle.jsonl again.

It needs pymscl (MicroStrain's MSCL). Wheels of pymscl do not exist for every system, so the project keeps the file
instead of a dependency. The packets are random ones of each data set that our decoder reads, valid and invalid, and two
packets of real devices, published with the MIP SDK. MSCL reads only from a connection, so the packets are sent over a
socket.
"""

from __future__ import annotations

import importlib
import json
import random
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from seatrial.daq.protocol import mip

FILE = Path(__file__).parents[2] / "docs/data/mip-oracle.jsonl"
N = 30  # random packets for each data set
NAMES = {  # names in MSCL and names in our samples
    "scaledAccelX": "ax", "scaledAccelY": "ay", "scaledAccelZ": "az", "scaledGyroX": "p", "scaledGyroY": "q",
    "scaledGyroZ": "r", "scaledMagX": "mx", "scaledMagY": "my", "scaledMagZ": "mz", "roll": "roll", "pitch": "pitch",
    "yaw": "yaw", "estRoll": "roll", "estPitch": "pitch", "estYaw": "yaw", "latitude": "lat", "longitude": "lon",
    "heightAboveMSL": "alt", "horizontalAccuracy": "sigma_h", "northVelocity": "vel_n", "eastVelocity": "vel_e",
    "downVelocity": "vel_d", "groundSpeed": "speed", "horizontalDOP": "hdop", "gnssFixType": "fix",
    "gnssFixSvCount": "n_sat",
}  # fmt: skip
# Sensor data of a 3DM-CV7, and filter data of a device that has no solution yet.
REAL = (
    "7565804c0ad5000000055ee67cc00ad6000000014e434a000e043d9ee88d387fdb00bf7aaf030e05bb0c1e30bb572e68bbaa24ae0e07bc8a"
    "ac80bc72c50ebcc4e2c10e083eee3d9fbd66daddc0afdef59196",
    "756582c10ed3408c84ef9db22d0f000000000ad5000000d47c364c4010057ffffff87fc000007ffffff8000110067fc000007fc000007fc0"
    "000000011007000000000000000000000000000108100002000000001c010000000000000000000000000000000000000000000000000000"
    "10027fc000007fc000007fc0000000001c427ff80000000000007ff80000000000007ff80000000000000000094644642687000401100800"
    "00000000000000000000000000100900000000000000000000000000008756",
)


def packets() -> Iterator[bytes]:
    """Return the packets to send."""
    rng = random.Random(17)
    yield from map(bytes.fromhex, REAL)

    def floats(n: int, scale: float = 2.0) -> bytes:
        return struct.pack(f">{n}f", *(rng.uniform(-scale, scale) for _ in range(n)))

    for k in range(N):
        flag = struct.pack(">H", rng.random() < 0.8)
        yield mip.packet(mip.SENSOR, {0x04: floats(3), 0x05: floats(3), 0x06: floats(3), 0x0C: floats(3, 1.5)})
        yield mip.packet(mip.FILTER, {0x05: floats(3, 1.5) + flag})
        place = struct.pack(">4d2f", rng.uniform(-90, 90), rng.uniform(-180, 180), 60.0, rng.uniform(0, 99), 0.5, 0.9)
        valid = struct.pack(">H", rng.randrange(64))
        fields = {
            0x03: place + struct.pack(">H", 0x1F if k % 4 else rng.randrange(32)),
            0x05: floats(3) + struct.pack(">5f", 1.5, 1.25, 99.0, 0.1, 0.2) + valid,
            0x07: struct.pack(">7fH", *(rng.uniform(0.5, 9.0) for _ in range(7)), rng.randrange(128)),
            0x0B: struct.pack(">BBH", rng.choice((0, 1, 2, 3)), rng.randrange(32), 0)
            + struct.pack(">H", 3 if k % 3 else rng.randrange(4)),
        }
        yield mip.packet(mip.GNSS, fields)


def read(sent: list[bytes]) -> list[dict[str, float]]:
    """Return the values of each packet that MSCL calls valid, under the names of our samples, in MSCL's units."""
    mscl = importlib.import_module("mscl")
    server = socket.create_server(("127.0.0.1", 0))
    node = mscl.InertialNode(mscl.Connection.TcpIp("127.0.0.1", server.getsockname()[1]))
    connection, _ = server.accept()
    threading.Thread(target=lambda: [time.sleep(3.0), connection.sendall(b"".join(sent))], daemon=True).start()
    connection.sendall(mip.packet(mip.SENSOR, {0x0E: bytes(4)}))  # packets that arrive while MSCL initialises are lost
    found: list[dict[str, float]] = []
    while len(found) < len(sent):
        for packet in node.getDataPackets(500):
            points = [p for p in packet.data() if p.valid()]
            if [p.channelName() for p in points] != ["internalTimestamp"]:
                found.append({NAMES[p.channelName()]: p.as_double() for p in points if p.channelName() in NAMES})
    return found


if __name__ == "__main__":
    sent = list(packets())
    lines = ({"packet": packet.hex(), "values": values} for packet, values in zip(sent, read(sent), strict=True))
    FILE.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="ascii")
