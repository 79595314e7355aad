"""The page of a study: every number against what is wanted, and what misses stands out."""

from __future__ import annotations

from pathlib import Path

import pytest

from ident.report.study_page import write_study_page
from tests.ident import page_examples
from tests.ident.pages import Page, numbers


def test_what_misses_stands_out(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_study_page(page_examples.study(), page_examples.AIMS, path)
    page = Page(path.read_text(encoding="utf-8"))
    assert page.headings() == ["study-surge", "study-yaw", "study-none", "made"]
    styles = [str(attrs.get("class")) for tag, attrs in page.tags if tag == "td"]
    assert {style for style in styles if "bad" in style} == {"bad wide"}  # a sentence, in a row of numbers
    words = " ".join(page.words.split())
    assert "in 93 % to 97 % of the fits" in words
    assert "No replicate can be judged." in words
    assert "−0.170 ± 0.040" in words
    assert "89.0 (87.0 to 91.0) %" in words
    figures = list(page.figures().values())
    assert len(figures) == 6  # bias, variance and coverage of each study
    symbols = [figure["data"][0]["marker"]["symbol"] for figure in figures]
    assert symbols[:3] == [["circle", "circle"]] * 3
    assert symbols[3:] == [["circle", "diamond-open"], ["circle", "circle"], ["diamond", "circle"]]
    coverage = figures[5]
    assert numbers(coverage["data"][0]["x"]) == pytest.approx([89.0, 94.4])
    (band,) = coverage["layout"]["shapes"]
    assert (round(band["x0"]), round(band["x1"])) == (93, 97)
    assert coverage["layout"]["yaxis"]["ticktext"] == ["d_v", "s_u"]
