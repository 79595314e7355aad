"""`seatrial log --live`: the newest samples on a WebSocket that Foxglove opens (extra `live`).

The messages are those of the log: the same topics, types and encoding. It runs in the process that shows the table,
never in the one that records.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

from daq.acquisition import Source, Status
from daq.errors import SeatrialError
from daq.log import NANO, cdr_layout, full_definition, schema
from daq.rig import Rig
from daq.samples import NAN, Frame

PERIOD_S = 0.05  # wall; the status is no newer
_FOXGLOVE = "the live view needs the package foxglove-sdk: pip install 'seatrial[live]'"


class LiveServer:
    """Serves the samples of `status` at the address of `rig.live` while in the `with` block.

    Raises SeatrialError at entry.

    What is shown is the newest sample of each source twenty times a second; the log has them all.
    """

    def __init__(self, rig: Rig, status: Callable[[], Status]) -> None:
        self._rig, self._status = rig, status
        self._ending = threading.Event()
        self._channels: dict[str, Any] = {}
        self._sent: dict[Source, float] = {}
        self._thread = threading.Thread(target=self._run, name="live view", daemon=True)

    @property
    def address(self) -> str:
        """The address to open in Foxglove."""
        return f"ws://{self._rig.live.host}:{self._server.port}"

    def __enter__(self) -> LiveServer:
        try:
            import foxglove
        except ModuleNotFoundError as error:
            raise SeatrialError(_FOXGLOVE) from error
        self._foxglove = foxglove
        self._context = foxglove.Context()
        host, port = self._rig.live.host, self._rig.live.port
        try:
            self._server = foxglove.start_server(name="seatrial", host=host, port=port, context=self._context)
        except Exception as error:  # it raises errors of its own
            why = " ".join(str(error).split())
            raise SeatrialError(f"{host}:{port}: the live view cannot listen there: {why}") from error
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()
        self._server.stop()

    def _run(self) -> None:
        while not self._ending.wait(PERIOD_S):
            try:
                self.publish(self._status())
            except SeatrialError:  # the acquisition has ended; its parent reports it
                return

    def publish(self, status: Status) -> None:
        """Send every sample that is newer than the last one sent of its source."""
        for source, latest in status.latest.items():
            if latest.t <= self._sent.get(source, -math.inf):
                continue
            self._sent[source] = latest.t
            t_ns = round(latest.t * NANO)
            for message in schema.messages(source[0], Frame(latest.sample, latest.t, NAN)):
                data = cdr_layout(message.type_name, message.frame_id.encode()).pack(t_ns, *message.values)
                self._channel(message.topic, message.type_name).log(data, log_time=t_ns)

    def _channel(self, topic: str, type_name: str) -> Any:
        if topic not in self._channels:
            definition = full_definition(type_name).encode()
            self._channels[topic] = self._foxglove.Channel(
                topic,
                schema=self._foxglove.Schema(name=type_name, encoding="ros2msg", data=definition),
                message_encoding="cdr",
                context=self._context,
            )
        return self._channels[topic]
