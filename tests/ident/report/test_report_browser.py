"""Tests of every kind of page in headless Chromium: drawn without errors, not wider than a phone, and printable."""

from __future__ import annotations

import atexit
import re
import shutil
import tempfile
from functools import cache
from html import unescape
from pathlib import Path
from typing import NamedTuple

import pytest

from seatrial.ident.report.page import write_report
from tests.ident.pages import KINDS as CONTENTS
from tests.ident.pages import PAGES, Page, browser, chromium, loaded

pytestmark = [browser, pytest.mark.slow]
# Width of a phone in CSS pixels. The height shows the whole page, because figures are drawn when visible.
WIDTH, HEIGHT = 390, 30_000
# The page is in a frame at a twentieth of its size. The window of Chromium is never narrower than 500 pixels, which is
# wider than a phone, and painting millions of pixels is slow.
FRAME = """<!doctype html><style>iframe { position: absolute; top: 0; transform: scale(0.05); transform-origin: 0 0 }
</style><body><script>
addEventListener("load", () => setTimeout(() => {
  for (const frame of document.querySelectorAll("iframe")) {
    const root = frame.contentDocument.documentElement;
    const plot = frame.contentDocument.querySelector(".js-plotly-plot .main-svg");
    const found = document.createElement("pre");
    const titles = Array.from(frame.contentDocument.querySelectorAll(".annotation-text"));
    const end = Math.ceil(Math.max(0, ...titles.map((title) => title.getBoundingClientRect().right)));
    found.title = [root.clientWidth, root.scrollWidth, plot.getAttribute("width"), end].join(" ");
    found.textContent = root.outerHTML;
    document.body.append(found);
  }
}, 3000));
</script>"""
TRIES = 3  # On a busy machine, the virtual time of the browser may end before its first frame.


def with_long_titles(path: Path) -> None:
    """Write the page of a diagnosis whose simulations diverge, which the titles of their panels say."""
    content = CONTENTS["diagnosis"]()
    traces = [trace | {"diverged": trace["t"][len(trace["t"]) // 2]} for trace in content["traces"]]
    write_report(loaded(content | {"traces": traces}), path)


MAKERS = PAGES | {"long titles": with_long_titles}


class Drawn(NamedTuple):
    """A page drawn in a frame.

    It has the width of the page, the width that it needs, the width of its first figure, the end of its longest panel
    title, and its text.
    """

    wide: int
    needed: int
    plot: int
    titles: int
    text: str


@cache
def seen(kind: str) -> tuple[Path, Drawn, str]:
    """Return a page, its drawing by the browser, and the messages of the browser."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    page, frame = folder / "page.html", folder / "frame.html"
    MAKERS[kind](page)
    frame.write_text(f'{FRAME}<iframe src="{page.name}" width="{WIDTH}" height="{HEIGHT}"></iframe>', encoding="utf-8")
    for _ in range(TRIES):
        run = chromium(folder, "--window-size=500,1600", "--dump-dom", frame.as_uri())
        match = re.search(r'<pre title="(\d+) (\d+) (\d+) (\d+)">(.*?)</pre>', run.stdout, re.DOTALL)
        if match:
            break
    assert match, run.stderr
    *sizes, text = match.groups()
    return page, Drawn(*map(int, sizes), unescape(text)), run.stderr


KINDS = [kind if kind in ("diagnosis", "check") else pytest.param(kind, marks=pytest.mark.study) for kind in PAGES]


@pytest.mark.parametrize("kind", KINDS)
def test_browser_draws_every_figure_without_errors(kind: str) -> None:
    _, drawing, messages = seen(kind)
    assert "CONSOLE" not in messages, messages
    text = drawing.text
    page = Page(text)
    drawn = [attrs for _, attrs in page.tags if "js-plotly-plot" in str(attrs.get("class"))]
    assert drawn
    if 'class="away"' not in text:
        assert len(drawn) == len(page.figures())


@pytest.mark.parametrize("kind", [*KINDS, "long titles"])
def test_no_report_is_wider_than_a_phone(kind: str) -> None:
    _, page, _ = seen(kind)
    assert page.wide <= WIDTH
    assert page.needed <= page.wide  # Otherwise the page must be scrolled sideways.
    assert 200 < page.plot < page.wide
    assert page.titles <= WIDTH - 16  # the padding of the page


@pytest.mark.parametrize(
    ("kind", "most"), [pytest.param("noise", 6, marks=pytest.mark.study), ("check", 8), ("diagnosis", 20)]
)
def test_report_can_be_printed(kind: str, most: int, tmp_path: Path) -> None:
    pdf = tmp_path / "report.pdf"
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", seen(kind)[0].as_uri())
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= most


PAPER = """<!doctype html><body><script>
addEventListener("load", () => setTimeout(() => {
  const inner = document.querySelector("iframe").contentWindow;
  inner.dispatchEvent(new Event("beforeprint"));
  const found = document.createElement("pre");
  found.title = Array.from(inner.document.querySelectorAll(".plot"))
    .filter((plot) => plot.offsetParent && /^(Bode|Reliability)/.test(plot.ariaLabel))
    .map((plot) => plot.clientWidth).join(" ");
  document.body.append(found);
}, 3000));
</script>"""


def test_two_printed_plots_beside_each_other_are_wide_enough(tmp_path: Path) -> None:
    """A page of paper is 680 pixels wide. Plots with a legend and Bode plots need 300 of them."""
    page, frame = seen("diagnosis")[0], tmp_path / "paper.html"
    frame.write_text(f'{PAPER}<iframe src="{page.as_uri()}" width="800" height="9000"></iframe>', encoding="utf-8")
    for _ in range(TRIES):
        run = chromium(
            tmp_path, "--window-size=900,1600", "--allow-file-access-from-files", "--dump-dom", frame.as_uri()
        )
        if match := re.search(r'<pre title="([\d ]+)">', run.stdout):
            break
    assert match, run.stderr
    assert all(300 <= int(width) <= 680 for width in match[1].split())
