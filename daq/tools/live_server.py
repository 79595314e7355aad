"""WebSocket server of the newest samples for Foxglove, for `seatrial log --live` (extra `live`).

The messages have the topics, types and encoding of the log. The server runs in the process that shows the live table,
never in the process that records. The server of the library does not check the origin of a connection. Therefore
connections pass a gate that checks it. Otherwise every web page in a browser of this computer could read the samples.
"""

from __future__ import annotations

import asyncio
import contextlib
import html
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

PERIOD_S = 0.05  # s of wall time; the acquisition does not update its status more often
HEAD_S, HEAD_BYTES = 5.0, 16_384  # limits of the head of a request
_OURS = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?|file://")  # pages and programs of this computer
_ORIGIN = re.compile(rb"^origin:[ \t]*(.*?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
_UPGRADE = re.compile(rb"^upgrade:[ \t]*websocket[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
_BROWSER_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>seatrial log --live</title>
<h1>Live samples for Foxglove</h1>
<p>This port is not a web page. It is the WebSocket of <code>seatrial log --live</code>.</p>
<p>In Foxglove: Open connection, Foxglove WebSocket, <code>ws://{host}:{port}</code></p>
<p>For a page in the browser: <code>seatrial log RIG --view</code>, or <code>seatrial view LOG</code>.</p>
"""
_FOXGLOVE = "the live view needs the package foxglove-sdk: pip install 'seatrial[live]'"


class LiveServer:
    """WebSocket server of the newest samples for Foxglove, within a `with` block, at the address in `rig.live`.

    Twenty times a second the server sends the newest sample of each source, if it was not sent before. Only the log has
    all samples.

    Parameters
    ----------
    rig
        Rig with the address.
    status
        Function that returns the status of the acquisition.

    Raises
    ------
    SeatrialError
        At the beginning of the block, if a package is not installed or the address is not available.
    """

    def __init__(self, rig: Rig, status: Callable[[], Status]) -> None:
        """Store the rig and the function that returns the status. The server starts at the beginning of the block."""
        self._rig, self._status = rig, status
        self._ending = threading.Event()
        self._channels: dict[str, Any] = {}
        self._sent: dict[Source, float] = {}
        self._thread = threading.Thread(target=self._publish_until_end, name="live view", daemon=True)

    @property
    def address(self) -> str:
        """Address (ws://HOST:PORT) of the live view, to be opened in Foxglove. It is known after the start."""
        return f"ws://{self._rig.live.host}:{self._gate.port}"

    def __enter__(self) -> LiveServer:
        """Start the server of the live view, its gate (`OriginGate`), and the thread that sends the samples.

        Raise SeatrialError if the package foxglove-sdk is not installed or the address is not available.
        """
        try:
            import foxglove
        except ModuleNotFoundError as error:
            raise SeatrialError(_FOXGLOVE) from error
        # Otherwise the library prints a line into the live table when a client disconnects without a close message.
        foxglove.set_log_level("CRITICAL")
        self._foxglove = foxglove
        self._context = foxglove.Context()
        live = self._rig.live
        behind = "127.0.0.1"
        if sys.platform == "linux":  # all of 127.0.0.0/8 is this computer: a web page cannot guess a random address
            behind = "127." + ".".join(str(random.SystemRandom().randrange(1, 255)) for _ in range(3))
        with contextlib.ExitStack() as stack:
            try:
                self._server = foxglove.start_server(name="seatrial", host=behind, port=0, context=self._context)
                stack.callback(self._server.stop)
                self._gate = OriginGate(live.host, live.port, (behind, self._server.port), live.origins)
            except Exception as error:  # the library raises errors of other classes, too
                reason = " ".join(str(error).split())
                raise SeatrialError(
                    f"{live.host}:{live.port}: the live view cannot listen there: {reason}; give another port in "
                    "[live] of the rig"
                ) from error
            stack.pop_all()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the thread that sends the samples, the server and the gate, and wait until the thread has ended.

        An error in the block is not suppressed.
        """
        self._ending.set()
        self._thread.join()
        # Stop the server before the gate, which forwards its close messages. Otherwise the library prints errors.
        self._server.stop()
        self._gate.close()

    def _publish_until_end(self) -> None:
        """Send the newest samples of the acquisition every 0.05 s until the `with` block or the acquisition ends."""
        while not self._ending.wait(PERIOD_S):
            try:
                self.publish(self._status())
            except SeatrialError:  # the acquisition has ended; its parent reports it
                return

    def publish(self, status: Status) -> None:
        """Send to the clients each sample of a status that is newer than the last sent sample of its source.

        A status has the newest sample of each source, which is a device, a further kind of its samples, or a speed
        controller.
        """
        for source, latest in status.latest.items():
            if latest.t <= self._sent.get(source, -math.inf):
                continue
            self._sent[source] = latest.t
            t_ns = round(latest.t * NANO)
            device = source[0].partition("/")[0]  # DEVICE/KIND for a device with several kinds of samples
            for message in schema.messages(device, Frame(latest.sample, latest.t, NAN)):
                self._channel_of_topic(message.topic, message.type_name).log(message.pack(t_ns), log_time=t_ns)

    def _channel_of_topic(self, topic: str, type_name: str) -> Any:
        """Return the Foxglove channel of a topic; create it if it does not exist.

        `type_name` is the type of its messages, for example "sensor_msgs/msg/Imu".
        """
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
    """Network proxy in front of the server of the live view that rejects connections from web pages of foreign sites.

    A browser states the site of a page in the header `Origin` (RFC 6454, section 7). Accepted are programs, which send
    no origin, pages of this computer, and pages of the sites in `origins`. The gate listens from its creation until
    `close`.

    Parameters
    ----------
    host, port
        Address of the gate; port 0 for any free port.
    behind
        Address of the server.
    origins
        Accepted origins, such as "https://app.foxglove.dev".

    Raises
    ------
    OSError
        If the address is not available.

    Attributes
    ----------
    port : int
        Port of the gate.
    """

    def __init__(self, host: str, port: int, behind: tuple[str, int], origins: Sequence[str]) -> None:
        """Listen at `host` and `port`, and forward accepted connections to the server `behind` the gate.

        A thread of the gate serves the connections, so that the constructor returns at once. Raise OSError if the
        address is not available.
        """
        self._host, self._behind, self._origins = host, behind, origins
        self._loop = asyncio.new_event_loop()
        self._tasks: dict[asyncio.Task[None], asyncio.StreamWriter] = {}  # task of each connection, and its client
        try:
            listening = asyncio.start_server(self._start_connection, host, port, limit=HEAD_BYTES)
            self._server = self._loop.run_until_complete(listening)
        except OSError:
            self._loop.close()
            raise
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="live gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the gate of the live view and all its connections, and wait until its thread has ended.

        It may be called only once.
        """
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _end(self) -> None:
        """Close the listening socket of the gate and all its connections, and wait for their tasks."""
        self._server.close()
        for task, client in list(self._tasks.items()):
            client.close()  # a task that has not started yet would not close its client
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.sleep(0)  # asyncio frees closed connections in the next cycle of its loop

    def _is_allowed(self, head: bytes) -> bool:
        """Return whether the gate accepts a connection by the head of its HTTP request.

        Accepted are requests without an origin, from pages of this computer, and from the origins given to the gate. If
        the head states several origins, all must be accepted.
        """
        origins = [origin.decode("latin-1") for origin in _ORIGIN.findall(head)]
        return all(origin in self._origins or _OURS.fullmatch(origin) for origin in origins)

    def _browser_page(self) -> bytes:
        """Return the reply (426 Upgrade Required) to a browser, with a page on what the port is and how to connect."""
        page = _BROWSER_PAGE.format(host=html.escape(self._host), port=self.port).encode()
        head = (
            "HTTP/1.1 426 Upgrade Required\r\nUpgrade: websocket\r\nConnection: close, Upgrade\r\n"
            f"Content-Type: text/html; charset=utf-8\r\nContent-Length: {len(page)}\r\n"
            "Content-Security-Policy: default-src 'none'\r\nX-Content-Type-Options: nosniff\r\n\r\n"
        )
        return head.encode() + page

    def _start_connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Start a task that serves a new connection to the gate.

        The task belongs to this class, because asyncio prints a traceback when it cancels tasks of its own.
        """
        task = self._loop.create_task(self._serve(reader, writer))
        self._tasks[task] = writer
        task.add_done_callback(self._tasks.pop)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Check the origin of a client; forward all bytes between client and server until both end, or reply 403.

        A client that asks for no WebSocket, such as a browser, gets a page that explains the port.
        Only the head of the first request of a connection is checked.
        `reader` and `writer` are the ends of the connection with the client. The connection is closed without a reply
        if the head of the request is larger than 16 kB or takes longer than 5 s.
        """
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
            if self._is_allowed(head) and not _UPGRADE.search(head):
                writer.write(self._browser_page())
                await writer.drain()
            elif self._is_allowed(head):
                server_reader, server_writer = await asyncio.open_connection(*self._behind)
                server_writer.write(head)
                await asyncio.gather(_forward_bytes(reader, server_writer), _forward_bytes(server_reader, writer))
            else:
                writer.write(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                await writer.drain()
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            pass
        finally:
            writer.close()


async def _forward_bytes(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Forward bytes from a reader to a writer until the reader ends or a connection fails, and close the writer."""
    try:
        while data := await reader.read(65_536):
            writer.write(data)
            await writer.drain()
    except OSError:  # one side has closed the connection: the other side is closed, which ends its `_forward_bytes`
        pass
    finally:
        writer.close()
