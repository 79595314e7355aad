"""Tests of the server of a page: accepted clients, possible requests, and the refusal of all methods except GET."""

from __future__ import annotations

import http.client
import json
import os
import re
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import LoadCell
from seatrial.daq.view import server
from seatrial.daq.view.server import PAGE, PageServer, listen, new_token
from seatrial.daq.view.viewed_log import ViewedLog
from tests.daq.logs import N_ROUNDS, write_everything


class Served(NamedTuple):
    """A page that is served: its port, its token, and the folder of its log."""

    port: int
    token: str
    folder: Path

    def ask(self, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes, http.client.HTTPMessage]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10.0)
        try:
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            return answer.status, answer.read(), answer.headers
        finally:
            connection.close()

    def json(self, path: str) -> Any:
        status, content, headers = self.ask(f"/{self.token}/api/{path}")
        assert status == 200, content
        assert headers["Content-Type"] == "application/json"
        return json.loads(content)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("served")
    write_everything(folder / "a.mcap", N_ROUNDS)
    write_everything(folder / "b.mcap", 2)
    for name in ("a.mcap", "b.mcap"):
        os.utime(folder / name, (time.time() - 60.0,) * 2)
    token = new_token()
    with PageServer([ViewedLog(folder / "a.mcap"), ViewedLog(folder / "b.mcap")], listen(0), token) as page:
        thread = threading.Thread(target=page.serve_forever)
        thread.start()
        assert page.address == f"http://127.0.0.1:{page.server_address[1]}/{token}/"
        yield Served(page.server_address[1], token, folder)
        page.shutdown()
        thread.join()


def test_the_server_listens_on_loopback_only(served: Served) -> None:
    with socket.create_connection(("127.0.0.1", served.port)) as connection:
        assert connection.getpeername()[0] == "127.0.0.1"
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
    for address in others - {f"127.0.{k}.1" for k in range(256)}:
        with pytest.raises(OSError, match="refused"):
            socket.create_connection((str(address), served.port), timeout=2.0)


def test_tokens_are_long_and_differ() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 24


@pytest.mark.parametrize("name", PAGE)
def test_the_files_of_the_page_need_the_token(served: Served, name: str) -> None:
    status, content, headers = served.ask(f"/{served.token}/{name}")
    assert status == 200
    assert len(content) > 500
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "unsafe" not in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cache-Control"] == "no-store"
    assert "Access-Control-Allow-Origin" not in headers


def test_the_page_loads_no_file_from_the_network(served: Served) -> None:
    for name in ("", "view.js", "view.css", "uplot.min.css"):
        text = served.ask(f"/{served.token}/{name}")[1].decode()
        addresses = set(re.findall(r"https?://[^\s\"'`)]*|[\"'(]//[\w.]+", text))
        assert addresses <= {"http://www.w3.org/2000/svg"}, name  # the name space of SVG is not fetched
    assert b"innerHTML" not in served.ask(f"/{served.token}/view.js")[1]


@pytest.mark.parametrize("name", ["", "view.js", "api/logs", "api/log", "api/data", "api/cut?interval=1:2", "missing"])
def test_requests_without_the_token_are_refused(served: Served, name: str) -> None:
    wrong = "A" * len(served.token)
    almost = served.token[:-1] + ("a" if served.token[-1] != "a" else "b")
    for path in (f"/{name}", f"/{wrong}/{name}", f"/{almost}/{name}", f"/{served.token}x/{name}", f"//{name}"):
        status, content, headers = served.ask(path)
        assert status == 403, path
        assert served.token.encode() not in content
        assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert served.ask(f"/{served.token}")[0] == 403
    assert served.ask("/%C3%BC/")[0] == 403


def test_a_site_whose_name_points_to_this_computer_is_refused(served: Served) -> None:
    path = f"/{served.token}/api/logs"
    for host in ("evil.example", f"evil.example:{served.port}", f"127.0.0.1:{served.port + 1}", "127.0.0.1", ""):
        assert served.ask(path, Host=host)[0] == 403, host
    for host in (f"127.0.0.1:{served.port}", f"localhost:{served.port}"):
        assert served.ask(path, Host=host)[0] == 200
    with socket.create_connection(("127.0.0.1", served.port), timeout=10.0) as connection:  # without, and with two
        connection.sendall(f"GET {path} HTTP/1.0\r\n\r\n".encode())
        assert b" 403 " in connection.recv(4096).splitlines()[0]
    host = f"Host: 127.0.0.1:{served.port}\r\n"
    with socket.create_connection(("127.0.0.1", served.port), timeout=10.0) as connection:
        connection.sendall(f"GET {path} HTTP/1.1\r\n{host}Host: evil.example\r\n\r\n".encode())
        assert b" 403 " in connection.recv(4096).splitlines()[0]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "HEAD", "TRACE", "CONNECT"])
def test_only_get_is_possible(served: Served, method: str) -> None:
    status, _, headers = served.ask(f"/{served.token}/api/log", method)
    assert (status, headers["Allow"]) == (405, "GET")


def test_an_unknown_method_or_no_http_is_refused(served: Served) -> None:
    assert served.ask(f"/{served.token}/", "THRUST")[0] == 501
    for request in (
        b"\x00\xff\r\n\r\n",
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /" + b"a" * 70_000 + b" HTTP/1.0\r\n",
    ):
        with socket.create_connection(("127.0.0.1", served.port), timeout=10.0) as connection:
            connection.sendall(request)
            connection.shutdown(socket.SHUT_WR)
            assert b"Traceback" not in connection.recv(4096)
    assert served.json("logs") == ["a.mcap", "b.mcap"]


def test_no_other_file_can_be_read(served: Served) -> None:
    (served.folder / "secret.txt").write_text("secret")
    for name in (
        "../server.py", "..%2fserver.py", "%2e%2e/server.py", "page/view.js", "/etc/passwd", "..\\server.py",
        "view.js/../../server.py", "view.js%00", "uplot-license.txt", "api/../view.js",
        quote(str(served.folder / "secret.txt")),
    ):  # fmt: skip
        status, content, _ = served.ask(f"/{served.token}/{name}")
        assert status == 404, name
        assert content == b"no such page\n"


def test_data_equal_the_content_of_the_log(served: Served) -> None:
    with open_log(served.folder / "a.mcap") as log:
        raw = log.table(LoadCell, "loadcell")
    signal = quote("/loadcell/counts:counts")
    found = served.json(
        f"data?log=0&from=0&to=99&points=1000&signal={signal}&signal=missing:x&signal={quote('/ahrs/imu:none')}"
    )
    assert list(found) == ["/loadcell/counts:counts"]
    values = [value for value in found["/loadcell/counts:counts"]["value"] if value is not None]
    np.testing.assert_array_equal(values, raw["counts"])
    assert len(served.json(f"data?log=1&from=0&to=99&points=1000&signal={signal}")["/loadcell/counts:counts"]["t"]) == 4
    content = served.json("log?log=1")
    assert (content["name"], content["state"], content["n_events"]) == ("b.mcap", "whole", 2)
    assert served.json("track?track=%2Fgnss%2Fgnss&from=0&to=99&points=100")["east"] == pytest.approx([0.0] * N_ROUNDS)
    assert {finding["level"] for finding in served.json("check?log=0")} <= {"fault", "warning", "unknown", "ok"}
    assert served.json("cut?interval=1:2.5")["options"] == "--from 1.000 --to 2.500"


@pytest.mark.parametrize(
    "query",
    [
        "log?log=2", "log?log=-1", "log?log=one", "log?log=%D9%A1", "data?from=0&to=1", "data?from=nan&to=1&points=9",
        "data?from=0&to=inf&points=9", "data?from=2&to=1&points=9", "data?from=0&to=1&points=x",
        "data?from=0&to=1&points=9" + "&signal=x" * 65, "log?" + "a=1&" * 400, "cut?interval=1", "cut?interval=2:1",
        "cut?interval=a:b", "cut?interval=nan:nan", "log?log",
    ],
)  # fmt: skip
def test_a_wrong_request_gives_a_one_line_error(served: Served, query: str) -> None:
    status, content, _ = served.ask(f"/{served.token}/api/{query}")
    assert status == 400
    assert content.count(b"\n") == 1
    assert b"Traceback" not in content


def test_a_missing_track_is_not_found(served: Served) -> None:
    assert served.ask(f"/{served.token}/api/track?track=x&from=0&to=1&points=9")[0] == 404


def test_many_and_silent_connections_do_not_block_for_ever(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server._PageRequest, "timeout", 0.5)
    silent = [socket.create_connection(("127.0.0.1", served.port), timeout=10.0) for _ in range(100)]
    try:
        begin = time.monotonic()
        while True:
            try:
                assert served.json("logs") == ["a.mcap", "b.mcap"]
                break
            except OSError:  # all places are taken: the connection was closed
                assert time.monotonic() - begin < 8.0
                time.sleep(0.1)
        assert threading.active_count() < 40
    finally:
        for connection in silent:
            connection.close()


def test_a_port_in_use_gives_a_one_line_error(served: Served) -> None:
    with pytest.raises(SeatrialError, match=f"{served.port}.*give another --port"):
        listen(served.port)
