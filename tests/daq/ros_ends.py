"""Other ends of live ROS 2: a Zenoh router, and a node written from the design of rmw_zenoh without our code."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from typing import Any, Self

import pytest

zenoh = pytest.importorskip("zenoh", reason="no Zenoh here (extra ros2)")
FLOAT64 = "std_msgs::msg::dds_::Float64_/RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a"


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def session(mode: str, connect: list[str], listen: list[str]) -> Any:
    quiet = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    text = {"mode": mode, "connect": {"endpoints": connect, "timeout_ms": 0}, "listen": {"endpoints": listen}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps({**text, "scouting": quiet})))


class Router:
    """Router of Zenoh on loopback, in the role of `ros2 run rmw_zenoh_cpp rmw_zenohd`."""

    def __init__(self, address: str = "") -> None:
        self.address = address or f"tcp/127.0.0.1:{free_port()}"
        self._session: Any = None

    def start(self) -> None:
        self._session = session("router", [], [self.address])

    def stop(self) -> None:
        if self._session is not None:
            self._session.close()
            self._session = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *reason: object) -> None:
        self.stop()


class Commander:
    """Node that commands thruster `left` at `rate` Hz. `n` may be changed at any time; None sends no command."""

    def __init__(self, router: Router, rate: float = 50.0) -> None:
        self.n: float | bytes | None = 0.0
        self._session = session("client", [router.address], [])
        self._publisher = self._session.declare_publisher(f"0/thrusters/left/command/{FLOAT64}")
        self._gid, self._sent, self._period = struct.pack("<Q", id(self)) * 2, 0, 1.0 / rate
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def command(self, n: float | bytes | None) -> None:
        """Send this command from now on."""
        self.n = n

    def send(self, n: float | bytes, ago_s: float = 0.0) -> None:
        """Send a command as if it had been sent at least `ago_s` earlier."""
        self._sent += 1
        attachment = struct.pack("<qqB", self._sent, time.time_ns() - round(ago_s * 1e9), 16) + self._gid
        data = n if isinstance(n, bytes) else b"\x00\x01\x00\x00" + struct.pack("<d", n)
        self._publisher.put(data, attachment=attachment)

    def _run(self) -> None:
        while not self._ending.wait(self._period):
            if (n := self.n) is not None:
                self.send(n)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self._ending.set()
        self._thread.join()
        self._session.close()
