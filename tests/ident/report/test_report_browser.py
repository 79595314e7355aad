"""Every kind of page in headless Chromium: drawn without complaint, no wider than a telephone, printed, zoomed."""

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

from tests.ident.pages import PAGES, Page, browser, chromium

pytestmark = [browser, pytest.mark.slow]
WIDTH, HEIGHT = 390, 30_000  # CSS pixels of a telephone; all of a page is in sight, where figures are drawn
# In a frame, shown at a twentieth of its size: Chromium's own window is never narrower than 500, which is wider than a
# telephone, and to paint millions of pixels takes long.
FRAME = """<!doctype html><style>iframe { position: absolute; top: 0; transform: scale(0.05); transform-origin: 0 0 }
</style><body><script>
addEventListener("load", () => setTimeout(() => {
  for (const frame of document.querySelectorAll("iframe")) {
    const root = frame.contentDocument.documentElement;
    const plot = frame.contentDocument.querySelector(".js-plotly-plot .main-svg");
    const found = document.createElement("pre");
    found.title = [root.clientWidth, root.scrollWidth, plot.getAttribute("width")].join(" ");
    found.textContent = root.outerHTML;
    document.body.append(found);
  }
}, 3000));
</script>"""
TRIES = 3  # a busy machine may run out the browser's virtual time before its first frame


class Drawn(NamedTuple):
    """A page in a frame: the width that it has, that it needs, and of its first figure; its text when it is drawn."""

    wide: int
    needed: int
    plot: int
    text: str


@cache
def seen(kind: str) -> tuple[Path, Drawn, str]:
    """A page, what a browser made of it, and what it said."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    page, frame = folder / f"{kind}.html", folder / "frame.html"
    PAGES[kind](page)
    frame.write_text(f'{FRAME}<iframe src="{page.name}" width="{WIDTH}" height="{HEIGHT}"></iframe>', encoding="utf-8")
    for _ in range(TRIES):
        run = chromium(folder, "--window-size=500,1600", "--dump-dom", frame.as_uri())
        told = re.search(r'<pre title="(\d+) (\d+) (\d+)">(.*?)</pre>', run.stdout, re.DOTALL)
        if told:
            break
    assert told, run.stderr
    wide, needed, plot, text = told.groups()
    return page, Drawn(int(wide), int(needed), int(plot), unescape(text)), run.stderr


KINDS = [kind if kind in ("diagnosis", "check") else pytest.param(kind, marks=pytest.mark.study) for kind in PAGES]


@pytest.mark.parametrize("kind", KINDS)
def test_a_browser_draws_every_figure_without_complaint(kind: str) -> None:
    _, drawing, said = seen(kind)
    assert "CONSOLE" not in said, said
    text = drawing.text
    page = Page(text)
    drawn = [attrs for _, attrs in page.tags if "js-plotly-plot" in str(attrs.get("class"))]
    assert drawn
    if 'class="away"' not in text:
        assert len(drawn) == len(page.figures())


@pytest.mark.parametrize("kind", KINDS)
def test_no_report_is_wider_than_a_telephone(kind: str) -> None:
    _, page, _ = seen(kind)
    assert page.wide <= WIDTH
    assert page.needed <= page.wide  # else it has to be scrolled sideways
    assert 200 < page.plot < page.wide


@pytest.mark.parametrize(("kind", "most"), [pytest.param("noise", 6, marks=pytest.mark.study), ("check", 8)])
def test_a_report_prints(kind: str, most: int, tmp_path: Path) -> None:
    pdf = tmp_path / "report.pdf"
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", seen(kind)[0].as_uri())
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= most
