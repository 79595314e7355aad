"""Tests of the paper's tables and figures: the content of the pages, and recovery of the true values."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.thesis import printed, tables
from benchmarks.thesis.__main__ import main
from benchmarks.thesis.figures import Chart, Curve, Drawing, Part, write_figures
from benchmarks.thesis.fits import at_rest, surge_experiment, yaw_experiment
from seatrial.ident.estimation.standard_errors import AUTOCORRELATED_TOO_LONG
from seatrial.mocks.plant.bench import draw_bench
from tests.missions import bench_log

LIMIT = 6_000_000  # length in bytes


@pytest.mark.parametrize(("make", "paper"), [(yaw_experiment, printed.TABLE_3), (surge_experiment, printed.TABLE_4)])
def test_prediction_error_finds_the_truth_and_output_error_claims_too_much(make, paper) -> None:
    bench = make(2)
    names = list(paper["OE"])
    assert tables.distance(bench.pe, bench.truth, names) < 3.5
    mass = names[0]
    robust = bench.oe.robust_errors[bench.oe.names.index(mass)]
    if mass == "m_r":
        assert robust > 2 * bench.oe.estimate(mass)[1]
    else:  # a disturbance shifts the position permanently, which the standard errors do not include
        assert np.isnan(robust)
        assert (mass, AUTOCORRELATED_TOO_LONG) in bench.oe.flags
    head, _, *rows = tables.tables_3_and_4(bench, paper)
    assert "paper OE" in head
    assert len(rows) == 3
    for name, row in zip(names, rows, strict=True):
        cells = [c.strip() for c in row.strip("|").split("|")]
        assert cells[0].startswith(f"`{name}`")
        assert float(cells[1]) == pytest.approx(paper["OE"][name], rel=1e-3)
        assert float(cells[3]) == pytest.approx(bench.truth[name], rel=1e-3)


def test_the_noise_measured_at_rest_matches_the_simulated_noise() -> None:
    for name, record in at_rest(3).items():
        white, walk = record.truth
        assert abs(record.found.white - white) < 4 * record.found.white_error, name
        assert abs(record.found.walk - walk) < 4 * record.found.walk_error, name


@pytest.mark.study
def test_both_pages_are_written(tmp_path: Path) -> None:
    log = bench_log(tmp_path / "bench.mcap", draw_bench(2))
    quick = ["--evaluations", "300", "--repeats", "8"]
    assert main(["--seed", "2", "--out", str(tmp_path), "--bench", str(log), *quick]) == 0
    text = (tmp_path / "thesis.md").read_text(encoding="utf-8")
    for k in (2, 3, 4, 5):
        assert f"## Table {k}" in text
    assert "8 simulated repeats" in text
    assert text.index("## Table 5") < text.index("## Chapter 5")
    assert "log bench.mcap" in text
    assert str(tmp_path) not in text
    (distances,) = re.findall(r"3DOF ([\d.]+), 6DOF K ([\d.]+), 3DOF with forces", text)
    assert float(distances[1]) < 4 < float(distances[0])
    page = (tmp_path / "thesis.html").read_text(encoding="utf-8")
    assert len(page.encode()) < LIMIT
    for figure in ("4.1", "4.2", "4.3", "5.1", "5.2", "5.3", "6.1", "6.2", "6.3", "6.4", "6.5", "6.6"):
        assert f"Figure {figure}" in page
    assert "http://" not in re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)


def test_a_log_of_another_kind_gives_a_one_line_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "none.mcap"
    assert main(["--out", str(tmp_path), "--bench", str(path)]) == 1
    err = capsys.readouterr().err.splitlines()
    assert err[-1].startswith("seatrial: ")
    assert "none.mcap" in err[-1]
    assert not (tmp_path / "thesis.md").exists()


def test_a_page_of_figures_contains_its_curves(tmp_path: Path) -> None:
    x = np.linspace(1.0, 10.0, 30)
    charts = [
        Chart("one <b>", [Curve("a", x, x, "measured"), Curve("b", x, -x, "band", x)]),
        Chart("two", [Curve("a", x, x**2)], log=True),
    ]
    parts = [Part("p", "Part", [Drawing("d", "s", charts)])]
    write_figures(tmp_path / "a.html", "kind", "what it shows", "lead", parts)
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    (found,) = re.findall(r'<script type="application/json" id="figures">(.*?)</script>', page, re.DOTALL)
    (figure,) = json.loads(found)["figures"].values()
    traces = figure["data"]
    assert [(t["name"], t["showlegend"]) for t in traces] == [("a", True), ("b", True), ("a", False)]
    assert traces[0]["y"] == pytest.approx(list(x), rel=1e-5)
    assert figure["layout"]["yaxis2"]["type"] == "log"
    assert "type" not in figure["layout"]["yaxis"]
