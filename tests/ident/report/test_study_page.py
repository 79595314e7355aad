"""Tests of the page of a study: every number is compared with its aim, and misses are highlighted."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest

from seatrial.ident.report.study_page import by_chance, picture, write_study_page
from tests.ident import page_examples
from tests.ident.pages import Page, numbers

SVG = "{http://www.w3.org/2000/svg}"


def test_misses_are_highlighted(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_study_page(page_examples.study(), page_examples.AIMS, path)
    page = Page(path.read_text(encoding="utf-8"))
    assert page.headings() == ["study-surge", "study-yaw", "study-none", "made"]
    styles = [str(attrs.get("class")) for tag, attrs in page.tags if tag == "td"]
    # This cell contains a sentence in a row of numbers.
    assert {style for style in styles if "bad" in style} == {"bad wide"}
    words = " ".join(page.words.split())
    assert "in 93 % to 97 % of the fits" in words
    assert "No parameter can be evaluated: fewer than three of 500 replicates are usable" in words
    assert "−0.170 ± 0.040" in words
    assert "89.0 (87.0 to 91.0) %" in words
    figures = list(page.figures().values())
    assert len(figures) == 6  # Bias, variance and coverage of each study.
    symbols = [figure["data"][0]["marker"]["symbol"] for figure in figures]
    assert symbols[:3] == [["circle", "circle"]] * 3
    assert symbols[3:] == [["circle", "diamond-open"], ["circle", "circle"], ["diamond", "circle"]]
    coverage = figures[5]
    assert numbers(coverage["data"][0]["x"]) == pytest.approx([89.0, 94.4])
    (band,) = coverage["layout"]["shapes"]
    assert (round(band["x0"]), round(band["x1"])) == (93, 97)
    assert coverage["layout"]["yaxis"]["ticktext"] == ["d_v", "s_u"]


def test_statistics_that_are_not_finite_leave_gaps(tmp_path: Path) -> None:
    """The variance over the bound is infinite if the bound is zero."""
    result, unknown = page_examples.study(), float("nan")
    first, *others = result.studies
    infinite = msgspec.structs.replace(
        first.parameters[0], bound_ratio=float("inf"), bound_ratio_low=float("inf"), bound_ratio_high=float("inf"),
        bias=unknown, bias_error=unknown,
    )  # fmt: skip
    many = [[infinite, *first.parameters[1:]], [infinite]]
    result = msgspec.structs.replace(
        result, studies=[*(msgspec.structs.replace(first, parameters=found) for found in many), *others]
    )
    path = tmp_path / "report.html"
    write_study_page(result, page_examples.AIMS, path)
    page = Page(path.read_text(encoding="utf-8"))
    figures = list(page.figures().values())
    for figure in figures[:6]:
        assert np.isfinite(figure["layout"]["xaxis"]["range"]).all()
    assert [figure["data"][0]["text"] for figure in figures[:6]] == [["d_u"], ["d_u"], ["m_u", "d_u"], [], [], ["m_u"]]
    assert figures[1]["layout"]["yaxis"]["ticktext"] == ["m_u", "d_u"]
    words = " ".join(page.words.split())
    assert "inf" not in words.replace("information", "")
    assert "nan" not in words
    drawn = ElementTree.fromstring(picture(result.studies[0], page_examples.AIMS))
    assert len(drawn.findall(f"{SVG}circle")) == 1 + 1 + 2 + 1  # One mark is in the key.


def test_picture_has_a_mark_for_every_number_and_its_bands() -> None:
    fine, poor, _ = page_examples.study().studies
    drawn = ElementTree.fromstring(picture(fine, page_examples.AIMS))
    assert len(drawn.findall(f"{SVG}circle")) == 2 * 3 + 1  # One more mark is in the key.
    assert len(drawn.findall(f"{SVG}path")) == 2
    drawn = ElementTree.fromstring(picture(poor, page_examples.AIMS))
    fills = [path.get("fill") for path in drawn.findall(f"{SVG}path")]
    # One certain miss, one possible miss, and the key.
    assert sorted(fills) == ["#D55E00", "#D55E00", "#ffffff", "#ffffff"]
    dashed = [line for line in drawn.findall(f"{SVG}line") if line.get("stroke-dasharray")]
    assert len(dashed) == 2 * 3
    words = [text.text for text in drawn.findall(f"{SVG}text")]
    assert words[:2] == ["d_v", "s_u"]
    assert {"bias, standard deviations", "variance / bound", "coverage of 95 % intervals, %"} < set(words)


def test_chance_bands_cover_random_statistics() -> None:
    rng, n = np.random.default_rng(3), 200
    z = rng.normal(size=(4000, n))
    found = {
        "bias": z.mean(axis=1) / z.std(axis=1, ddof=1),
        "ratio": z.var(axis=1, ddof=1),
        "coverage": np.mean(np.abs(z) < 1.96, axis=1),
    }
    for key, values in found.items():
        low, high = by_chance(key, n)
        assert np.mean((low <= values) & (values <= high)) == pytest.approx(0.95, abs=0.02), key
