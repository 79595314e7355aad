"""Tests of the page beside a run: a flooded, stopped or killed server of the page does not change the run."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Command
from tests.bench.runs import MISSION_RUN, SPEED, Run, assert_plan_was_run, is_alive, running, short_mission
from tests.bench.standin import StandIn

N_CONNECTIONS = 100
COMMANDS = "/esc/1/command:n_cmd"
LATE_S = 0.1  # wall s by which a set-point may be late on a machine that runs other programs too


def address_of(run: Run) -> str:
    """Return the address of the page that a command has printed."""
    assert run.process.stdout is not None
    line = run.process.stdout.readline()
    found = re.fullmatch(r"page at (http://127\.0\.0\.1:\d+/[\w-]+/)\n", line)
    assert found, line
    return found[1]


def ask(address: str, path: str) -> Any:
    url = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", url.port or 0, timeout=10.0)
    try:
        connection.request("GET", f"{url.path}{path}")
        answer = connection.getresponse()
        assert answer.status == 200, answer.read()
        return json.loads(answer.read())
    finally:
        connection.close()


def until_state(address: str, state: str, seconds: float = 20.0) -> Any:
    """Ask until the log of the page has a state, and return its content."""
    end = time.monotonic() + seconds
    while True:
        with contextlib.suppress(OSError, http.client.HTTPException):
            content = ask(address, "api/log")
            if content["state"] == state and (state != "live" or content["tables"]):
                return content
        assert time.monotonic() < end, state
        time.sleep(0.1)


@contextlib.contextmanager
def flood(address: str) -> Iterator[list[int]]:
    """Keep 100 connections busy: half request all data, and half send no request or do not read the answer."""
    url, ending, answers = urlsplit(address), threading.Event(), [0]
    request = f"GET {url.path}api/log HTTP/1.0\r\nHost: 127.0.0.1:{url.port}\r\n\r\n".encode()

    def client(number: int) -> None:
        while not ending.is_set():
            with (
                contextlib.suppress(OSError),
                socket.create_connection(("127.0.0.1", url.port or 0), timeout=2.0) as sock,
            ):
                if number % 4 == 0:  # silent
                    ending.wait(1.0)
                    continue
                sock.sendall(request)
                if number % 4 == 1:  # does not read
                    ending.wait(1.0)
                    continue
                while sock.recv(65_536):
                    answers[0] += 1
            ending.wait(0.05)

    threads = [threading.Thread(target=client, args=(number,)) for number in range(N_CONNECTIONS)]
    for thread in threads:
        thread.start()
    try:
        yield answers
    finally:
        ending.set()
        for thread in threads:
            thread.join()


def server_of(runner: int) -> int:
    """Return the process id of the server of the page, a child of a command, as soon as there is one."""
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        for folder in Path("/proc").iterdir():
            with contextlib.suppress(OSError, ValueError):
                words = (folder / "cmdline").read_bytes().split(b"\0")
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                if parent == runner and b"seatrial.daq.view.live_process" in words:
                    return int(folder.name)
        time.sleep(0.05)
    raise AssertionError("no server of the page")


def lateness(log: Path) -> np.ndarray:
    """Return by how many wall seconds each set-point of the short mission was sent late."""
    with open_log(log) as opened:
        rows = opened.table(Command, "esc", node=1)
        start = next(float(text.rpartition(" ")[2]) for _, kind, text in opened.events() if kind == "start")
    changes = rows["t"][1:][np.diff(rows["n_cmd"]) != 0.0]
    return (changes[:3] - start - np.array([3.0, 7.0, 11.0])) / SPEED


def signals_of(content: dict[str, Any]) -> set[str]:
    """Return the names of all signals that the page lists."""
    return {signal["id"] for table in content["tables"] for signal in table["signals"]}


def test_the_page_shows_a_run_while_it_lasts(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path)
    with running(tmp_path, (*MISSION_RUN, "--view")) as run:
        address = address_of(run)
        content, end = until_state(address, "live"), time.monotonic() + 10.0
        while not {"/esc/1/state:rpm", "/loadcell/counts:force"} <= signals_of(content):  # one may come later
            assert time.monotonic() < end, signals_of(content)
            time.sleep(0.1)
            content = ask(address, "api/log")
        run.until_turning(standin)
        end, shown = time.monotonic() + 10.0, False
        while not shown:
            data = ask(address, "api/log") and ask(address, f"api/data?signal={COMMANDS}&from=0&to=99&points=500")
            shown = COMMANDS in data and any(data[COMMANDS]["value"])
            assert time.monotonic() < end
            time.sleep(0.1)
        server = server_of(run.process.pid)
        assert run.end() == 0, run.err
    assert not is_alive(server)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", urlsplit(address).port or 0), timeout=2.0)


@pytest.mark.parametrize("attack", ["none", "flood", "stop", "kill"])
def test_a_flooded_stopped_or_killed_page_does_not_change_the_run(
    standin: StandIn, tmp_path: Path, attack: str
) -> None:
    mission = short_mission(tmp_path)
    with running(tmp_path, (*MISSION_RUN, "--view")) as run, contextlib.ExitStack() as stack:
        address = address_of(run)
        until_state(address, "live")
        server = server_of(run.process.pid)
        if attack == "flood":
            answers = stack.enter_context(flood(address))
        if attack in ("stop", "kill"):
            run.until_turning(standin)
            os.kill(server, signal.SIGSTOP if attack == "stop" else signal.SIGKILL)
        assert run.end() == 0, run.err
        if attack == "flood":
            assert answers[0] > 50
    assert not is_alive(server)
    assert assert_plan_was_run(run.log, mission) == 0
    late = lateness(run.log)
    assert np.all(np.abs(late) < LATE_S), late
    with open_log(run.log) as log:
        assert not log.warnings
        assert not {"stop", "skipped", "warning"} & {kind for _, kind, _ in log.events()}
        assert log.health("esc")[-1][1].dropped == 0


def test_the_server_ends_with_a_killed_command(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path)
    with running(tmp_path, (*MISSION_RUN, "--view")) as run:
        address_of(run)
        server = server_of(run.process.pid)
        os.kill(run.process.pid, signal.SIGKILL)
        end = time.monotonic() + 5.0
        while is_alive(server):
            assert time.monotonic() < end
            time.sleep(0.05)


def test_the_server_has_the_lowest_priority(standin: StandIn, tmp_path: Path) -> None:
    short_mission(tmp_path)
    with running(tmp_path, (*MISSION_RUN, "--view")) as run:
        address = address_of(run)
        until_state(address, "live")
        server = server_of(run.process.pid)
        assert os.getpriority(os.PRIO_PROCESS, server) == 19
        assert os.sched_getscheduler(server) == os.SCHED_BATCH
        assert Path(f"/proc/{server}/oom_score_adj").read_text().strip() == "1000"
        assert (
            urlsplit(address).path.strip("/") not in Path(f"/proc/{server}/cmdline").read_text()
        )  # others can read it


def test_a_log_that_exists_is_refused_before_a_page_is_served(tmp_path: Path, standin: StandIn) -> None:
    short_mission(tmp_path)
    (tmp_path / "run.mcap").write_bytes(b"an earlier run")
    with running(tmp_path, (*MISSION_RUN, "--view")) as run:
        assert run.end() == 1
    assert "page at" not in run.out
    assert "never overwritten" in run.line()
