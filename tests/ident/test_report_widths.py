"""Where a report has little room: a terminal of 80 columns, a telephone, a printed page."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from rich.console import Console

from ident.report import print_result, write_report
from ident.report.access import Take
from tests.ident.test_report import KINDS

CHROMIUM = next((name for name in ("chromium", "chromium-browser", "google-chrome") if shutil.which(name)), None)
browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on PATH")
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


def printed(result: dict[str, object]) -> str:
    console = Console(width=80, file=io.StringIO(), color_system=None)
    print_result(result, console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_a_long_warning_leaves_the_numbers_their_room() -> None:
    result = KINDS["thruster"]()
    rows = result["fit"]["parameters"]
    rows[0]["flag"] = "its error takes the other one at its bound for granted; without that it would be 0.23"
    text = printed(result)
    assert "2.794 ± 0.021" in text
    assert "⚠ its error takes the other one" in text
    assert max(map(len, text.splitlines())) <= 80


def test_a_log_that_is_called_by_its_role_is_named_once() -> None:
    assert Take("validation", "validation").title == "validation"
    assert Take("morning", "estimation").title == "estimation · morning"


def chromium(folder: Path, *words: str) -> str:
    """What headless Chromium prints."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    options += [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=30000"]
    options += ["--allow-file-access-from-files"]
    done = subprocess.run([str(CHROMIUM), *options, *words], capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


@browser
@pytest.mark.slow
def test_no_report_is_wider_than_a_telephone(tmp_path: Path) -> None:
    frames = []
    for kind, make in KINDS.items():
        write_report(make(), tmp_path / f"{kind}.html")
        frames.append(f'<iframe name="{kind}" src="{kind}.html" width="{PHONE}" height="3000"></iframe>')
    page = tmp_path / "phones.html"
    page.write_text("\n".join([WRAP, *frames]), encoding="utf-8")
    width = (len(KINDS) + 1) * PHONE  # all in sight: figures are drawn when they are
    for _ in range(3):  # a busy machine may run out the browser's virtual time before its first frame
        dom = chromium(tmp_path, f"--window-size={width},3000", "--dump-dom", page.as_uri())
        found = re.findall(r"\[(\w+) (\d+) (\d+) (\d+)\]", dom)
        if len(found) == len(KINDS):
            break
    assert {name for name, *_ in found} == set(KINDS)
    for name, wide, needed, plot in found:
        assert int(wide) <= PHONE
        assert int(needed) <= int(wide), f"{name} has to be scrolled sideways"
        assert 200 < int(plot) < int(wide), name


@browser
@pytest.mark.slow
def test_a_report_prints(tmp_path: Path) -> None:
    write_report(KINDS["noise"](), tmp_path / "report.html")
    pdf = tmp_path / "report.pdf"
    chromium(tmp_path, f"--print-to-pdf={pdf}", "--no-pdf-header-footer", (tmp_path / "report.html").as_uri())
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 6
