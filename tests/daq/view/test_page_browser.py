"""Tests of the page in headless Chromium: it is drawn without errors, and is not wider than a phone."""

from __future__ import annotations

import contextlib
import inspect
import os
import re
import threading
import time
from pathlib import Path

import pytest

from seatrial.daq.view.server import PageServer, listen, new_token
from seatrial.daq.view.viewed_log import ViewedLog
from tests.daq.logs import N_ROUNDS, recorder, write_everything
from tests.daq.view.test_viewed_log import write_run
from tests.ident.pages import browser, chromium

pytestmark = [browser, pytest.mark.slow]
FOLDER = Path(inspect.getfile(PageServer)).parent / "page"
TRIES = 3  # on a busy machine, the virtual time of the browser may end before its first frame


def drawn(folder: Path, logs: list[Path], width: int) -> str:
    """Return the page of some logs as the browser has drawn it, after a check that it reported no error."""
    with PageServer([ViewedLog(log) for log in logs], listen(0), new_token()) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            for _ in range(TRIES):
                run = chromium(folder, f"--window-size={width},1400", "--dump-dom", server.address)
                assert "CONSOLE" not in run.stderr, run.stderr
                if 'data-drawn="' in run.stdout:
                    return run.stdout
        finally:
            server.shutdown()
            thread.join()
    raise AssertionError(run.stderr)


@pytest.mark.parametrize("width", [500, 1400])
def test_the_page_draws_signals_track_events_and_health(tmp_path: Path, width: int) -> None:
    with contextlib.closing(recorder(tmp_path / "run.mcap")) as log:
        write_run(log, 30.0)
        log.event(1_700_000_012.0, "warning", "ahrs <script>alert(1)</script>: disconnected")
    os.utime(tmp_path / "run.mcap", (time.time() - 60.0,) * 2)
    page = drawn(tmp_path, [tmp_path / "run.mcap"], width)
    titles = re.findall(r"<h4>([^<]*)</h4><ul>", page)
    assert titles == ["yaw [rad]", "r [rad/s]", "speed [m/s]", "n_cmd"] or set(titles) >= {"speed [m/s]", "n_cmd"}
    assert page.count('class="u-over"') == len(titles)
    assert "ahrs &lt;script&gt;alert(1)&lt;/script&gt;: disconnected" in page
    assert "<td>/ahrs/imu</td>" in page
    canvas = re.search(r'<canvas id="map"[^>]*width="(\d+)"', page)
    assert canvas is not None
    assert 200 < int(canvas[1]) < width


def test_a_log_without_samples_is_a_page_too(tmp_path: Path) -> None:
    recorder(tmp_path / "empty.mcap").close()
    write_everything(tmp_path / "other.mcap", N_ROUNDS)
    for name in ("empty.mcap", "other.mcap"):
        os.utime(tmp_path / name, (time.time() - 60.0,) * 2)
    page = drawn(tmp_path, [tmp_path / "empty.mcap", tmp_path / "other.mcap"], 1400)
    assert "This log has no position" in page
    assert "This log has no events" in page
    assert 'value="1">other.mcap' in page


def test_the_label_of_a_point_at_the_right_edge_is_on_its_left(tmp_path: Path) -> None:
    """The label "start" was cut to "star"."""
    function = re.search(r"function labelPlace.*?\n}\n", (FOLDER / "view.js").read_text(encoding="utf-8"), re.DOTALL)
    assert function is not None
    calls = "[[100, 30, 400], [363, 30, 400], [364, 30, 400]].map((given) => labelPlace(...given))"
    script = f"{function[0]}document.body.textContent = JSON.stringify({calls});"
    (tmp_path / "page.html").write_text(f"<body><script>{script}</script></body>", encoding="utf-8")
    page = chromium(tmp_path, "--dump-dom", (tmp_path / "page.html").as_uri()).stdout
    assert '[{"align":"left","at":107},{"align":"left","at":370},{"align":"right","at":357}]' in page
