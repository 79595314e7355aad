"""JSON lines over a socket, between the acquisition process and the one that started it."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from typing import Any

Message = dict[str, Any]


class AcquisitionChannel:
    """One end. `send` may be called from any thread, `receive` from one."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._lock = threading.Lock()
        self._buffer = bytearray()

    def fileno(self) -> int:
        """What to wait on."""
        return self._socket.fileno()

    def send(self, message: Message) -> None:
        """Send one message; raises OSError when the other end is gone."""
        data = json.dumps(message, separators=(",", ":")).encode() + b"\n"
        with self._lock:
            self._socket.sendall(data)

    def receive(self) -> list[Message]:
        """Wait for bytes and return the messages that are complete; raises EOFError when the other end is gone."""
        try:
            data = self._socket.recv(1 << 20)
        except OSError as error:
            raise EOFError from error
        if not data:
            raise EOFError
        self._buffer += data
        *lines, rest = self._buffer.split(b"\n")
        self._buffer = rest
        return [json.loads(line) for line in lines]

    def messages(self) -> Iterator[Message]:
        """All messages until the other end is gone."""
        while True:
            try:
                yield from self.receive()
            except EOFError:
                return

    def close(self) -> None:
        """Close; a `receive` that waits in another thread ends too."""
        with contextlib.suppress(OSError):  # the other end may have gone first
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
