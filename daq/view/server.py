"""Server of the page of logs: HTTP on 127.0.0.1, read-only, for one user with a token.

The page is at http://127.0.0.1:PORT/TOKEN/. Only GET is answered, only with the token, and only if the browser believes
that it talks to this computer (header `Host`), so that neither another site nor another user can read the log. No
request can change anything: there is no writing method, and no file of the computer is served except those of PAGE.
"""

from __future__ import annotations

import contextlib
import hmac
import math
import secrets
import socket
import threading
from collections.abc import Callable, Sequence
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec

from seatrial.daq.errors import SeatrialError
from seatrial.daq.view.viewed_log import ViewedLog

LOOPBACK = "127.0.0.1"
MAX_CONNECTIONS = 16  # at a time; further ones are closed at once
REQUEST_S = 10.0  # wall s that one read or write of a connection may take
MAX_SIGNALS, MAX_INTERVALS, MAX_POINTS = 64, 200, 4000  # in one request
TOKEN_BYTES = 18
PAGE = {  # files of the page, with their types
    "": ("index.html", "text/html; charset=utf-8"),
    "view.js": ("view.js", "text/javascript; charset=utf-8"),
    "view.css": ("view.css", "text/css; charset=utf-8"),
    "uplot.min.js": ("uplot.min.js", "text/javascript; charset=utf-8"),
    "uplot.min.css": ("uplot.min.css", "text/css; charset=utf-8"),
}
SECURITY = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",  # the address has the token
    "Cache-Control": "no-store",
}


def new_token() -> str:
    """Return a random token for the address of a page."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def listen(port: int) -> socket.socket:
    """Return a socket that listens on a port of 127.0.0.1; port 0 is any free port.

    Raise SeatrialError if the port is in use or not allowed.
    """
    try:
        return socket.create_server((LOOPBACK, port))
    except OSError as error:
        raise SeatrialError(
            f"{LOOPBACK}:{port}: the page cannot be served there: {error.strerror}; give another --port"
        ) from error


def page_address(listening: socket.socket, token: str) -> str:
    """Return the address of the page that a server on a listening socket serves with a token."""
    return f"http://{LOOPBACK}:{listening.getsockname()[1]}/{token}/"


class PageServer(ThreadingHTTPServer):
    """Server of the page of some logs. `serve_forever` answers requests until `shutdown` is called by another thread.

    Parameters
    ----------
    logs
        The logs of the page.
    listening
        Socket that listens on 127.0.0.1 (`listen`).
    token
        Token in the address of the page.

    Attributes
    ----------
    address : str
        Address of the page.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(self, logs: Sequence[ViewedLog], listening: socket.socket, token: str) -> None:
        """Take over the listening socket."""
        super().__init__(listening.getsockname(), _PageRequest, bind_and_activate=False)
        self.socket.close()
        self.socket = listening
        self.logs, self.token = logs, token.encode()
        self.address = page_address(listening, token)
        port = listening.getsockname()[1]
        self.hosts = (f"{LOOPBACK}:{port}", f"localhost:{port}")
        self._free = threading.Semaphore(MAX_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread that answers a connection. If 16 connections are open, close a further connection at once."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a connection, and make room for the next one."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore an error of a connection, such as a client that went away or was too slow."""


class _RefusedError(Exception):
    """Error of a request that is refused: HTTP status and reason, which are sent as the answer."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        """Store the status and the reason."""
        super().__init__(reason)
        self.status = status


class _PageRequest(BaseHTTPRequestHandler):
    """One request to the server of a page."""

    server: PageServer
    server_version, sys_version = "seatrial", ""
    timeout = REQUEST_S

    def do_GET(self) -> None:
        """Answer a GET request: a file of the page, or data of a log.

        A refused request, or an error of reading the log, is answered by its HTTP status and one line of text.
        """
        try:
            content, kind = self._answer()
            status = HTTPStatus.OK
        except _RefusedError as error:
            content, kind, status = f"{error}\n".encode(), "text/plain; charset=utf-8", error.status
        except SeatrialError as error:
            content, kind, status = f"{error}\n".encode(), "text/plain; charset=utf-8", HTTPStatus.INTERNAL_SERVER_ERROR
        except (MemoryError, OSError, RuntimeError, ValueError) as error:  # damaged data, or no memory left
            text = f"this cannot be shown ({type(error).__name__})\n"
            content, kind, status = text.encode(), "text/plain; charset=utf-8", HTTPStatus.INTERNAL_SERVER_ERROR
        self._send(status, kind, content)

    def _refuse_method(self) -> None:
        """Refuse any method other than GET, because a request must not change anything."""
        self._send(HTTPStatus.METHOD_NOT_ALLOWED, "text/plain; charset=utf-8", b"only GET\n", {"Allow": "GET"})

    do_HEAD = do_POST = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_TRACE = do_CONNECT = _refuse_method

    def _answer(self) -> tuple[bytes, str]:
        """Return the content and the type of the answer to a GET request.

        Raise _RefusedError if host or token are wrong, if there is no such page, or if a parameter is invalid. Errors
        of reading the log are passed on.
        """
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0] not in self.server.hosts:
            # A page of another site may make its own name point to 127.0.0.1 (DNS rebinding).
            raise _RefusedError(HTTPStatus.FORBIDDEN, "this page is for the browser of this computer")
        url = urlsplit(self.path)
        _, _, rest = url.path.partition("/")
        token, slash, name = rest.partition("/")
        if not hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self.server.token) or not slash:
            raise _RefusedError(HTTPStatus.FORBIDDEN, "wrong token: open the address that the command printed")
        if name in PAGE:
            file, kind = PAGE[name]
            return _page_file(file), kind
        answer = _ANSWERS.get(name)
        if answer is None:
            raise _RefusedError(HTTPStatus.NOT_FOUND, "no such page")
        query = _Query(url.query, self.server.logs)
        return msgspec.json.encode(answer(query)), "application/json"

    def _send(self, status: HTTPStatus, kind: str, content: bytes, more: dict[str, str] | None = None) -> None:
        """Send an answer with the headers that protect the page (SECURITY) and the headers `more`.

        `kind` is the type of the content. HEAD requests get no content. The connection is closed afterwards (HTTP 1.0).
        """
        self.send_response(status)
        headers = {**SECURITY, **(more or {}), "Content-Type": kind, "Content-Length": str(len(content))}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send the answer to a request that is no valid HTTP: the status `code` and its standard text.

        `message` and `explain` are not used.
        """
        self._send(HTTPStatus(code), "text/plain; charset=utf-8", f"{HTTPStatus(code).phrase}\n".encode())

    def log_message(self, format: str, *args: Any) -> None:
        """Ignore the message, because the command alone prints on the terminal."""


@cache
def _page_file(name: str) -> bytes:
    """Return the content of a file of the page. Each file is read once."""
    return (Path(__file__).parent / "page" / name).read_bytes()


class _Query:
    """Checked parameters of a request. Each method raises _RefusedError (400) if its parameter is wrong."""

    def __init__(self, text: str, logs: Sequence[ViewedLog]) -> None:
        """Parse the part of an address after the question mark.

        Raise _RefusedError if this part is not a list of NAME=VALUE, or if it has more than 264 values.
        """
        try:
            self._values = parse_qs(text, max_num_fields=MAX_SIGNALS + MAX_INTERVALS, strict_parsing=bool(text))
        except ValueError as error:
            raise self._wrong("the parameters cannot be read") from error
        self.logs = logs

    @staticmethod
    def _wrong(reason: str) -> _RefusedError:
        """Return the error of an invalid request."""
        return _RefusedError(HTTPStatus.BAD_REQUEST, reason)

    def log(self) -> ViewedLog:
        """Return the log whose number, from 0, is the parameter `log`; the first log without this parameter.

        Raise _RefusedError if there is no such log.
        """
        text = self._values.get("log", ["0"])[0]
        if not (text.isascii() and text.isdecimal() and len(text) < 5 and int(text) < len(self.logs)):
            raise self._wrong("log: no such log")
        return self.logs[int(text)]

    def number(self, name: str) -> float:
        """Return a parameter that is a finite number. Raise _RefusedError if it is missing or is no such number."""
        try:
            value = float(self._values[name][0])
        except (KeyError, ValueError) as error:
            raise self._wrong(f"{name}: must be a number") from error
        if not math.isfinite(value):
            raise self._wrong(f"{name}: must be a finite number")
        return value

    def points(self) -> int:
        """Return the parameter `points`, a number of intervals or points, as a whole number.

        A number below 1 becomes 1, and one above 4000 becomes 4000. Raise _RefusedError if it is missing or no number.
        """
        return min(max(int(self.number("points")), 1), MAX_POINTS)

    def window(self) -> tuple[float, float]:
        """Return the parameters `from` and `to` [s of the log]. Raise _RefusedError unless `from` is before `to`."""
        begin, end = self.number("from"), self.number("to")
        if not begin < end:
            raise self._wrong("to: must be later than from")
        return begin, end

    def texts(self, name: str, most: int) -> list[str]:
        """Return all values of a parameter; none if it is missing. Raise _RefusedError for more than `most` values."""
        values = self._values.get(name, [])
        if len(values) > most:
            raise self._wrong(f"{name}: at most {most}")
        return values


class Points(msgspec.Struct):
    """Points of one signal to draw: times [s of the log] and values. NaN, which becomes null in JSON, is a gap."""

    t: list[float]
    value: list[float]


def _logs(query: _Query) -> list[str]:
    """Return the file names of the logs, in the order of their numbers. The parameters of the request are not used."""
    return [log.path.name for log in query.logs]


def _data(query: _Query) -> dict[str, Points]:
    """Return the points to draw of each signal in the request, by its id. Unknown signals are left out."""
    log, (begin, end), points = query.log(), query.window(), query.points()
    found = {}
    for signal in query.texts("signal", MAX_SIGNALS):
        with contextlib.suppress(KeyError):
            curve = log.curve(signal, begin, end, points)
            found[signal] = Points(curve.t.tolist(), curve.value.tolist())
    return found


def _track(query: _Query) -> Any:
    """Return the points of the track whose name is the parameter `track`.

    Raise _RefusedError (404) if there is no such track.
    """
    (name,) = query.texts("track", 1) or [""]
    try:
        return query.log().track(name, *query.window(), query.points())
    except KeyError as error:
        raise _RefusedError(HTTPStatus.NOT_FOUND, "no such track") from error


def _cut(query: _Query) -> Any:
    """Return the intervals of the request, the parameters `interval` as BEGIN:END, as texts for other commands.

    Raise _RefusedError (400) if a parameter has another form, or if an interval is empty or begins before 0.
    """
    intervals = []
    for text in query.texts("interval", MAX_INTERVALS):
        try:
            begin, end = map(float, text.split(":"))
        except ValueError as error:
            raise _RefusedError(HTTPStatus.BAD_REQUEST, "interval: must be BEGIN:END") from error
        intervals.append((begin, end))
    try:
        return query.log().cut(intervals)
    except ValueError as error:
        raise _RefusedError(HTTPStatus.BAD_REQUEST, str(error)) from error


_ANSWERS: dict[str, Callable[[_Query], Any]] = {
    "api/logs": _logs,
    "api/log": lambda query: query.log().content(),
    "api/data": _data,
    "api/track": _track,
    "api/check": lambda query: query.log().findings(),
    "api/cut": _cut,
}
