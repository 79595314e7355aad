"""Tests of every kind of page in headless Chromium: drawn without errors, not wider than a phone, and printable."""

from __future__ import annotations

import atexit
import re
import shutil
import subprocess
import tempfile
from functools import cache
from html import unescape
from pathlib import Path
from typing import NamedTuple

import pytest

from seatrial.ident.report.page import figure_page, write_report
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
    const lists = Array.from(frame.contentDocument.querySelectorAll("[role=tablist]"));
    const hidden = Math.max(0, ...lists.map((list) => list.scrollWidth - list.clientWidth));
    found.title = [root.clientWidth, root.scrollWidth, plot.getAttribute("width"), end, hidden].join(" ");
    found.textContent = root.outerHTML;
    document.body.append(found);
  }
}, 3000));
</script>"""
CARD, FORMULA = '<article class="effect">.*?</article>', '(<p class="formula">)(.*?)(</p>)'
TRIES = 3  # On a busy machine, the virtual time of the browser may end before its first frame.


def with_long_titles(path: Path) -> None:
    """Write the page of a diagnosis whose simulations diverge, which the titles of their panels say."""
    content = CONTENTS["diagnosis"]()
    traces = [trace | {"diverged": trace["t"][len(trace["t"]) // 2]} for trace in content["traces"]]
    write_report(loaded(content | {"traces": traces}), path)


def with_many_tabs(path: Path) -> None:
    """Write the page of a diagnosis of five logs, each of which has a tab."""
    content = CONTENTS["diagnosis"]()
    traces = [trace | {"record": f"{trace['record']}_{i}"} for i in range(5) for trace in content["traces"]]
    write_report(loaded(content | {"traces": traces}), path)


def with_one_figure(path: Path) -> None:
    """Write the page of one figure, which has no contents beside it."""
    figure = {"data": [{"type": "scatter", "x": [0.0, 1.0], "y": [0.0, 1.0]}], "layout": {"height": 400}}
    path.write_text(figure_page("Measured (grey) and predicted (blue)", figure), encoding="utf-8")


MAKERS = PAGES | {"long titles": with_long_titles, "many tabs": with_many_tabs, "one figure": with_one_figure}


class Drawn(NamedTuple):
    """A page drawn in a frame.

    It has the width of the page, the width that it needs, the width of its first figure, the end of its longest panel
    title, the largest width of tabs that are out of sight, and its text.
    """

    wide: int
    needed: int
    plot: int
    titles: int
    hidden_tabs: int
    text: str


@cache
def seen(kind: str, width: int = WIDTH) -> tuple[Path, Drawn, str]:
    """Return a page, its drawing by the browser in a frame of this width [px], and the messages of the browser."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    page, frame = folder / "page.html", folder / "frame.html"
    MAKERS[kind](page)
    frame.write_text(f'{FRAME}<iframe src="{page.name}" width="{width}" height="{HEIGHT}"></iframe>', encoding="utf-8")
    for _ in range(TRIES):
        run = chromium(folder, "--window-size=500,1600", "--dump-dom", frame.as_uri())
        match = re.search(r'<pre title="(\d+) (\d+) (\d+) (\d+) (\d+)">(.*?)</pre>', run.stdout, re.DOTALL)
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


NEVER_VISIBLE = "<script>IntersectionObserver = class { observe() {} unobserve() {} };</script>"
OPEN_TABS = """<script>addEventListener("load", () => setTimeout(() => {
  document.querySelectorAll("[role=tab][aria-selected=false]").forEach((tab) => tab.click());
}, 3000));</script>"""


@pytest.mark.parametrize("tabs", [False, True])
def test_figures_are_drawn_without_being_reported_as_visible(tabs: bool, tmp_path: Path) -> None:
    """Pictures of a page by a headless browser had empty figures: its observer of visible parts did not report them.

    Figures of hidden tabs are drawn when their tab opens.
    """
    text = seen("many tabs")[0].read_text(encoding="utf-8")
    page = tmp_path / "page.html"
    page.write_text(text.replace("<head>", f"<head>{NEVER_VISIBLE}{OPEN_TABS if tabs else ''}", 1), encoding="utf-8")
    assert NEVER_VISIBLE in page.read_text(encoding="utf-8")
    found = Page(chromium(tmp_path, "--window-size=1400,600", "--dump-dom", page.as_uri()).stdout)
    drawn = sum("js-plotly-plot" in str(attrs.get("class")) for _, attrs in found.tags)
    assert (drawn == len(found.figures())) is tabs
    assert drawn > 0.3 * len(found.figures())


@pytest.mark.parametrize("kind", [*KINDS, "long titles", "many tabs", "one figure"])
def test_no_report_is_wider_than_a_phone(kind: str) -> None:
    _, page, _ = seen(kind)
    assert page.wide <= WIDTH
    assert page.needed <= page.wide  # Otherwise the page must be scrolled sideways.
    assert 200 < page.plot < page.wide
    assert page.titles <= WIDTH - 16  # the padding of the page
    assert page.hidden_tabs == 0  # A list of tabs that scrolls looks complete.


@pytest.mark.parametrize("width", [1000, 1280, 1920])
def test_a_page_without_contents_uses_the_width_of_a_screen(width: int) -> None:
    """It is not put into the narrow column of the contents, which other pages have beside the text."""
    _, page, _ = seen("one figure", width)
    assert page.needed <= page.wide
    assert 0.85 * min(width, 1100) < page.plot <= 1100


@pytest.mark.parametrize(
    ("kind", "most"), [pytest.param("noise", 6, marks=pytest.mark.study), ("check", 8), ("diagnosis", 20)]
)
def test_report_can_be_printed(kind: str, most: int, tmp_path: Path) -> None:
    pdf = tmp_path / "report.pdf"
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", seen(kind)[0].as_uri())
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= most


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="no pdftotext here (poppler-utils)")
def test_no_printed_page_ends_with_the_head_of_an_effect(tmp_path: Path) -> None:
    """One card is printed at many heights of the page."""
    text = seen("diagnosis")[0].read_text(encoding="utf-8")
    (style, *_), (card, *_) = (re.findall(part, text, re.DOTALL) for part in ("<style>.*?</style>", CARD))
    card = re.sub("<h2>.*?</h2>", "<h2>TITLE</h2>", re.sub(FORMULA, r"\1\2 FORMULA\3", card))
    spaced = "".join(
        f'<p style="break-before: page; height: {mm}mm; margin: 0"></p>{card}' for mm in range(150, 265, 3)
    )
    page, pdf = tmp_path / "cards.html", tmp_path / "cards.pdf"
    page.write_text(f"<!doctype html><meta charset=utf-8>{style}<main>{spaced}</main>", encoding="utf-8")
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.as_uri())
    run = subprocess.run(["pdftotext", "-layout", pdf, "-"], capture_output=True, text=True, check=True)
    ends = [part.strip().splitlines()[-1] for part in run.stdout.split("\f") if part.strip()]
    assert len(ends) > 40
    assert not [line for line in ends if "TITLE" in line or "FORMULA" in line]


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
