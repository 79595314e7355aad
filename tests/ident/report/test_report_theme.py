"""Tests of a report for every reader: size, colours of both themes, names for screen readers, packed figures."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from seatrial.ident.report import drawing
from tests.ident.pages import PAGES, Page, numbers

STYLE = (Path(drawing.__file__).parent / "templates/style.css").read_text(encoding="utf-8")
TEXT = ("ink", "soft", "faint", "after", "good", "bad")  # colours of text, on each of the backgrounds
GROUNDS = ("page", "wash", "note", "alarm")


def palette(dark: bool) -> dict[str, str]:
    """Return the colours of a theme by name."""
    light, _, rest = STYLE.partition("prefers-color-scheme: dark")
    found = dict(re.findall(r"--([a-z]+): (#[0-9a-f]{6})", light))
    return found | (dict(re.findall(r"--([a-z]+): (#[0-9a-f]{6})", rest)) if dark else {})


def contrast(foreground: str, background: str) -> float:
    """Return the contrast of two colours by WCAG 2.2, 1 to 21."""

    def luminance(colour: str) -> float:
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    high, low = sorted((luminance(foreground), luminance(background)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_text_has_the_contrast_of_wcag_aa_on_every_background(dark: bool) -> None:
    colours = palette(dark)
    poor = {(t, g) for t in TEXT for g in GROUNDS if contrast(colours[t], colours[g]) < 4.5}
    assert not poor


def test_figures_have_readable_colours_on_a_dark_page() -> None:
    page = palette(True)["page"]
    assert drawing.DARK["#ffffff"].lower() == page
    for light in (drawing.INK, drawing.FAINT):
        assert contrast(drawing.DARK[light], page) >= 4.5
    for light in (*drawing.LINES, drawing.MEASURED):
        assert contrast(drawing.DARK.get(light, light), page) >= 3.0


@pytest.mark.parametrize("kind", PAGES)
def test_page_is_small_and_has_names_and_headings_in_order(kind: str, tmp_path: Path) -> None:
    PAGES[kind](tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size < 3_000_000
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))
    # A figure contains buttons. The role of an image would hide them from screen readers.
    figures = [attrs for _, attrs in page.tags if attrs.get("class") == "plot"]
    assert all(attrs["role"] == "figure" and attrs["aria-label"] for attrs in figures)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert not re.search(r"<th[^>]*>\s*</th>", text)


def test_numbers_of_a_page_are_exact_to_a_65000th_of_their_range() -> None:
    x = np.linspace(0.0, 400.0, 500)
    y = np.where(x > 300.0, np.nan, 3.0 * np.sin(x) - 7.0)
    figure = drawing.single([drawing.line_trace(x, y, "wave", 3000)], "time [s]")
    (trace,) = drawing.compact(figure)["data"]
    assert len(trace["y"]["q"]) < 0.51 * len(figure["data"][0]["y"]["bdata"])
    np.testing.assert_allclose(numbers(trace["y"]), y, atol=6.0 / 65534)
    np.testing.assert_allclose(numbers(trace["x"]), x, atol=400.0 / 65534)
    log = drawing.single([drawing.line_trace(x, np.exp(-x), "decay", 3000)], "f", yaxis={"type": "log"})
    assert drawing.compact(log) is log
    flat = drawing.single([drawing.line_trace(x, np.full(500, np.nan), "gap", 3000)], "t")
    assert np.isnan(numbers(drawing.compact(flat)["data"][0]["y"])).all()
