"""`seatrial log --live`: the newest samples on a WebSocket that Foxglove opens (extra `live`).

The messages are those of the log: the same topics, types and encoding. It runs in the process that shows the table,
never in the one that records. The library's server asks nobody where he comes from, so a gate stands before it: else
any page in a browser of this computer could read the samples.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import re
import sys
import threading
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

from seatrial.daq.acquisition import Source, Status
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import NANO, full_definition, schema
from seatrial.daq.rig import Rig
from seatrial.daq.samples import NAN, Frame

PERIOD_S = 0.05  # wall; the status is no newer
HEAD_S, HEAD_BYTES = 5.0, 16_384  # of a request's head
_OURS = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?|file://")  # pages and programs of this computer
_ORIGIN = re.compile(rb"^origin:[ \t]*(.*?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
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
        return f"ws://{self._rig.live.host}:{self._gate.port}"

    def __enter__(self) -> LiveServer:
        try:
            import foxglove
        except ModuleNotFoundError as error:
            raise SeatrialError(_FOXGLOVE) from error
        foxglove.set_log_level("CRITICAL")  # a client that leaves without a farewell would be a line in the live table
        self._foxglove = foxglove
        self._context = foxglove.Context()
        live = self._rig.live
        behind = "127.0.0.1"
        if sys.platform == "linux":  # all of 127.0.0.0/8 is this computer: where a page does not find it
            behind = "127." + ".".join(str(random.SystemRandom().randrange(1, 255)) for _ in range(3))
        with contextlib.ExitStack() as stack:
            try:
                self._server = foxglove.start_server(name="seatrial", host=behind, port=0, context=self._context)
                stack.callback(self._server.stop)
                self._gate = OriginGate(live.host, live.port, (behind, self._server.port), live.origins)
            except Exception as error:  # the library raises errors of its own
                why = " ".join(str(error).split())
                raise SeatrialError(f"{live.host}:{live.port}: the live view cannot listen there: {why}") from error
            stack.pop_all()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()
        self._server.stop()  # before the gate, which passes on its farewell; else it prints that clients were reset
        self._gate.close()

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
            device = source[0].partition("/")[0]  # one of several kinds is DEVICE/KIND
            for message in schema.messages(device, Frame(latest.sample, latest.t, NAN)):
                self._channel(message.topic, message.type_name).log(message.pack(t_ns), log_time=t_ns)

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


class OriginGate:
    """Listens at an address, and connects to the server behind it whoever is no page of a foreign site: programs, which
    name no origin, pages of this computer, and those of `origins` (RFC 6454, 7). Raises OSError."""

    def __init__(self, host: str, port: int, behind: tuple[str, int], origins: Sequence[str]) -> None:
        self._behind, self._origins = behind, origins
        self._loop = asyncio.new_event_loop()
        self._tasks: dict[asyncio.Task[None], asyncio.StreamWriter] = {}  # of connections, each with its client
        try:
            listening = asyncio.start_server(self._accept, host, port, limit=HEAD_BYTES)
            self._server = self._loop.run_until_complete(listening)
        except OSError:
            self._loop.close()
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="live gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End it and its connections."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        self._server.close()
        for task, client in list(self._tasks.items()):
            client.close()  # of a task that has not begun, too
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.sleep(0)  # what was closed is let go of in the next turn

    def _is_welcome(self, head: bytes) -> bool:
        origins = [origin.decode("latin-1") for origin in _ORIGIN.findall(head)]
        return all(origin in self._origins or _OURS.fullmatch(origin) for origin in origins)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a connection in a task of our own: asyncio prints a traceback where it cancels one of its own."""
        task = self._loop.create_task(self._serve(reader, writer))
        self._tasks[task] = writer
        task.add_done_callback(self._tasks.pop)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
            if self._is_welcome(head):
                server_reader, server_writer = await asyncio.open_connection(*self._behind)
                server_writer.write(head)
                await asyncio.gather(_pump(reader, server_writer), _pump(server_reader, writer))
            else:
                writer.write(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                await writer.drain()
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            pass
        finally:
            writer.close()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while data := await reader.read(65_536):
            writer.write(data)
            await writer.drain()
    except OSError:  # one side is gone: the other is closed, and its pump ends likewise
        pass
    finally:
        writer.close()
