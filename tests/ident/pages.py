"""Report pages for tests: a page of every kind, a parser of pages, and a browser."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rich.console import Console

from benchmarks.thesis.figures import Chart, Curve, Drawing, Part, write_figures
from seatrial.ident.report.check_page import write_check_page
from seatrial.ident.report.design_page import write_design_page
from seatrial.ident.report.page import write_report
from seatrial.ident.report.study_page import write_study_page
from seatrial.ident.report.terminal import print_result
from seatrial.ident.results.parts import Result
from seatrial.ident.results.result_file import from_json, to_json
from tests.ident import navigation_example, page_examples, report_example, report_example_bench


def content_of(make: Callable[[], Result]) -> Callable[[], dict[str, Any]]:
    """Return a function that gives a copy of the file content of a result. The result is made once."""
    made = cache(lambda: to_json(make()))
    return lambda: dict(msgspec.json.decode(made()))


KINDS = {
    "diagnosis": content_of(lambda: loaded(report_example.diagnosis())),
    "thruster": content_of(lambda: loaded(report_example_bench.thruster())),
    "noise": content_of(report_example_bench.noise),
    "navigation": content_of(navigation_example.navigation),
}
HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&"


class Page(HTMLParser):
    """Parser of a page: elements, their text, and everything that a browser would load."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self._inside: str = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = tag
        if tag == "script":
            self.scripts.append((dict(attrs), ""))

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            attrs, text = self.scripts[-1]
            self.scripts[-1] = (attrs, text + data)
        elif self._inside != "style":
            self.words += data

    def figures(self) -> dict[str, Any]:
        found = [text for attrs, text in self.scripts if attrs.get("id") == "figures"]
        return dict(json.loads(found[0])["figures"])

    def headings(self) -> list[str]:
        return [str(attrs["id"]) for tag, attrs in self.tags if tag == "section"]


def shortened(value: Any) -> Any:
    """Return the result with short lists and complete matrices."""
    if isinstance(value, dict) and "matrix" in value:
        return value
    if isinstance(value, dict):
        return {key: shortened(item) for key, item in value.items()}
    if isinstance(value, list):
        rows = bool(value) and isinstance(value[0], dict | list)
        return [shortened(item) for item in value[:3]] if rows else value[:20]
    return value


def loaded(content: dict[str, Any]) -> Any:
    """Return a result from the content of its file."""
    return from_json(msgspec.json.encode(content, enc_hook=float))  # a tenth of the time of json; numpy has own floats


def written(content: dict[str, Any], folder: Path) -> str:
    """Return the text of the page of a result."""
    write_report(loaded(content), folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


def printed(content: dict[str, Any]) -> str:
    """Return the output in a terminal of 80 columns."""
    console = Console(file=io.StringIO(), width=80, color_system=None)
    print_result(loaded(content), console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def numbers(packed: Any) -> Any:
    """Return the values of an array in a figure. A gap of an array in 16 bits is NaN."""
    if not isinstance(packed, dict):
        return packed
    if "bdata" in packed:
        return np.frombuffer(base64.b64decode(packed["bdata"]), "<f4")
    levels = np.frombuffer(base64.b64decode(packed["q"]), "<u2")
    step = (packed["high"] - packed["low"]) / 65534
    return np.where(levels == 65535, np.nan, packed["low"] + step * levels)


def check(path: Path) -> None:
    """Write the page of a preflight with swapped sides and a mission that is simulated in advance."""
    write_check_page(page_examples.check(), [page_examples.checked_log()], "seatrial check boat.toml --report x", path)


def design(path: Path) -> None:
    """Write the page of a designed mission."""
    write_design_page(page_examples.design(), path)


def study(path: Path) -> None:
    """Write the page of two studies. One has parameters that miss their aims."""
    write_study_page(page_examples.study(), page_examples.AIMS, path)


def figures(path: Path) -> None:
    """Write a page of curves in groups, like the page of figures of the paper."""
    x = np.linspace(1.0, 10.0, 200)
    charts = [
        Chart("linear [N]", [Curve("measured", x, x, "measured"), Curve("95 %", x, x - 1, "band", x + 1)]),
        Chart("logarithmic", [Curve("axis", x, x**2, "axis"), Curve("truth", x, x**3, "truth")], log=True),
    ]
    drawings = [Drawing("A drawing", "frequency [Hz]", charts, "Its caption.")]
    write_figures(path, "Figures", "What they show.", "And how.", [Part("one", "One part", drawings)])


def _of(make: Callable[[], dict[str, Any]]) -> Callable[[Path], None]:
    return lambda path: write_report(loaded(make()), path)


# Every kind of page, with the function that writes it to a path.
PAGES: dict[str, Callable[[Path], None]] = {kind: _of(make) for kind, make in KINDS.items()}
PAGES |= {"check": check, "design": design, "study": study, "figures": figures}

CHROMIUM = next((name for name in ("chromium", "chromium-browser", "google-chrome") if shutil.which(name)), None)
browser = pytest.mark.skipif(CHROMIUM is None, reason="runs scripts of a page, which needs chromium on the PATH")


def chromium(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run headless Chromium without a network. Its profile is in ``folder``."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    options += [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=30000"]
    options += ["--allow-file-access-from-files", "--enable-logging=stderr"]
    command = [str(CHROMIUM), *options, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=True)
