"""Every kind of page in headless Chromium: drawn without complaint, no wider than a telephone, printed, zoomed."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.ident.pages import PAGES, Page, browser, chromium

pytestmark = [browser, pytest.mark.slow]
# CSS pixels: all of a page is in sight, since figures are drawn when they are.
DESK, PHONE = (1200, 20_000), (390, 3000)
# All pages at once, each in a frame that is shown at a twentieth of its size: to start a browser and to paint millions
# of pixels is what takes long. And Chromium's own window is never narrower than 500, which is wider than a telephone.
FRAMES = """<!doctype html><style>iframe { position: absolute; top: 0; transform: scale(0.05); transform-origin: 0 0 }
</style><body><script>
addEventListener("load", () => setTimeout(() => {
  for (const frame of document.querySelectorAll("iframe")) {
    const root = frame.contentDocument.documentElement;
    const plot = frame.contentDocument.querySelector(".js-plotly-plot .main-svg");
    const found = document.createElement("pre");
    found.title = [frame.name, root.clientWidth, root.scrollWidth, plot.getAttribute("width")].join(" ");
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


class Seen(NamedTuple):
    """What a browser made of the pages in ``folder``, on a desk and on a telephone, and what it said."""

    folder: Path
    desk: dict[str, Drawn]
    phone: dict[str, Drawn]
    said: str


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """Every kind of page."""
    folder, frames = tmp_path_factory.mktemp("pages"), []
    for k, (kind, write) in enumerate(PAGES.items()):
        write(folder / f"{kind}.html")
        for place, (width, height) in (("desk", DESK), ("phone", PHONE)):
            at = f"left: {70 * k}px" if place == "desk" else f"left: {700 + 30 * k}px"
            size = f'width="{width}" height="{height}" style="{at}"'
            frames.append(f'<iframe name="{place} {kind}" src="{kind}.html" {size}></iframe>')
    page = folder / "frames.html"
    page.write_text("".join([FRAMES, *frames]), encoding="utf-8")
    for _ in range(TRIES):
        run = chromium(folder, "--window-size=1000,1000", "--dump-dom", page.as_uri())
        told = re.findall(r'<pre title="(\w+) (\w+) (\d+) (\d+) (\d+)">(.*?)</pre>', run.stdout, re.DOTALL)
        if len(told) == len(frames):
            break
    found: dict[str, dict[str, Drawn]] = {"desk": {}, "phone": {}}
    for place, kind, wide, needed, plot, text in told:
        found[place][kind] = Drawn(int(wide), int(needed), int(plot), unescape(text))
    return Seen(folder, found["desk"], found["phone"], run.stderr)


@pytest.mark.parametrize("kind", PAGES)
def test_a_browser_draws_every_figure_without_complaint(kind: str, seen: Seen) -> None:
    assert "CONSOLE" not in seen.said, seen.said
    text = seen.desk[kind].text
    page = Page(text)
    drawn = [attrs for _, attrs in page.tags if "js-plotly-plot" in str(attrs.get("class"))]
    assert drawn
    if 'class="away"' not in text:
        assert len(drawn) == len(page.figures())


@pytest.mark.parametrize("kind", PAGES)
def test_no_report_is_wider_than_a_telephone(kind: str, seen: Seen) -> None:
    page = seen.phone[kind]
    assert page.wide <= PHONE[0]
    assert page.needed <= page.wide  # else it has to be scrolled sideways
    assert 200 < page.plot < page.wide


@pytest.mark.parametrize(("kind", "most"), [("noise", 6), ("check", 8)])
def test_a_report_prints(kind: str, most: int, seen: Seen, tmp_path: Path) -> None:
    pdf = tmp_path / "report.pdf"
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", (seen.folder / f"{kind}.html").as_uri())
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= most
