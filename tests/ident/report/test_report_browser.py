"""Every kind of page in headless Chromium: drawn without complaint, no wider than a telephone, printed, zoomed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.ident.pages import PAGES, Page, browser, chromium

pytestmark = [browser, pytest.mark.slow]
PHONE = 390  # CSS pixels
# Chromium's own window is never narrower than 500, so each report is put into a frame as wide as a telephone.
WRAP = """<!doctype html><body><script>
addEventListener("load", () => setTimeout(() => {
  for (const frame of document.querySelectorAll("iframe")) {
    const root = frame.contentDocument.documentElement;
    const plot = frame.contentDocument.querySelector(".js-plotly-plot .main-svg");
    document.body.append(`[${frame.name} ${root.clientWidth} ${root.scrollWidth} ${plot.getAttribute("width")}]`);
  }
}, 3000));
</script>"""
TRIES = 3  # a busy machine may run out the browser's virtual time before its first frame


@pytest.mark.parametrize("kind", PAGES)
def test_a_browser_draws_every_figure_without_complaint(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    PAGES[kind](path)
    for _ in range(TRIES):
        run = chromium(tmp_path, "--window-size=1200,20000", "--dump-dom", path.as_uri())
        assert "CONSOLE" not in run.stderr, run.stderr
        page = Page(run.stdout)
        drawn = [attrs for _, attrs in page.tags if "js-plotly-plot" in str(attrs.get("class"))]
        if drawn:
            break
    assert drawn
    if 'class="away"' not in run.stdout:
        assert len(drawn) == len(page.figures())


def test_no_report_is_wider_than_a_telephone(tmp_path: Path) -> None:
    frames = []
    for kind, write in PAGES.items():
        write(tmp_path / f"{kind}.html")
        frames.append(f'<iframe name="{kind}" src="{kind}.html" width="{PHONE}" height="3000"></iframe>')
    page = tmp_path / "phones.html"
    page.write_text("\n".join([WRAP, *frames]), encoding="utf-8")
    width = (len(PAGES) + 1) * PHONE  # all in sight: figures are drawn when they are
    for _ in range(TRIES):
        dom = chromium(tmp_path, f"--window-size={width},3000", "--dump-dom", page.as_uri()).stdout
        found = re.findall(r"\[(\w+) (\d+) (\d+) (\d+)\]", dom)
        if len(found) == len(PAGES):
            break
    assert {name for name, *_ in found} == set(PAGES)
    for name, wide, needed, plot in found:
        assert int(wide) <= PHONE
        assert int(needed) <= int(wide), f"{name} has to be scrolled sideways"
        assert 200 < int(plot) < int(wide), name


@pytest.mark.parametrize(("kind", "most"), [("noise", 6), ("check", 8)])
def test_a_report_prints(kind: str, most: int, tmp_path: Path) -> None:
    PAGES[kind](tmp_path / "report.html")
    pdf = tmp_path / "report.pdf"
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", (tmp_path / "report.html").as_uri())
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= most
