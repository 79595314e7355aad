"""Tests of a small fixed sample of the bench recovery study, and of its bookkeeping."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.recovery import bench_study
from tests.recovery.bench_study import BenchCase, Row, diagnose_bench, line, verdict
from tests.recovery.resumable import read
from tests.recovery.tables import as_markdown


@pytest.mark.study
def test_clean_bench_gives_no_effect() -> None:
    found = diagnose_bench(BenchCase("none", 1))
    assert found.effects == ()


@pytest.mark.study
def test_effect_alone_is_named_and_improves_the_model() -> None:
    """This is an effect of the shaft. tests/ident/diagnosis/test_thruster_diagnosis covers an effect of the force by
    commands.
    """
    row = bench_study.run_case(BenchCase("spin-up", 1))
    assert row.get("error") is None
    assert verdict(row) == "exact"
    assert row["after"]["n"] < 0.9 * row["before"]["n"]


def fake(effect: str, seed: int, found: list[str], *attribution: str, scale: float = 1.0) -> Row:
    key = BenchCase(effect, seed, scale).key
    errors = {"n": 0.002, "force": 0.5}
    return {
        "key": key, "effect": effect, "seed": seed, "scale": scale, "found": found, "attribution": list(attribution),
        "left": [], "cpu": 9.0, "before": errors, "after": errors, "code": "x",
    }  # fmt: skip


ROWS = [
    (fake("none", 1, []), "exact"),
    (fake("none", 2, ["spin-up"], "identified"), "wrong"),
    (fake("spin-up", 1, ["spin-up"], "identified"), "exact"),
    (fake("spin-up", 2, ["spin-up", "cell-lag"], "identified", "identified"), "first"),
    (fake("spin-up", 3, [], scale=0.5), "missed"),
    (fake("spin-up", 4, ["unknown n_dot(slip)"], "nonparametric"), "nonparametric"),
    (fake("spin-up", 5, ["slew-limit"], "ambiguous"), "ambiguous"),
    (fake("spin-up", 6, ["slew-limit"], "identified"), "wrong"),
]


@pytest.mark.parametrize(("row", "wanted"), ROWS)
def test_verdict_of_a_line(row: Row, wanted: str) -> None:
    assert verdict(row) == wanted
    assert wanted in line(row)


def test_tables_count_the_named_effects() -> None:
    rows = [row for row, _ in ROWS]
    together = {cells[0]: cells[1] for cells in bench_study.summary(rows)}
    assert together["true effect first, size 1"] == "2/5"
    assert together["only the true effect, size 1"] == "1/5"
    assert together["another effect first, identified, size 1"] == "1/5"
    assert together["another effect identified anywhere, size 1"] == "2/5"
    assert together["true effect first, size 0.5"] == "0/1"
    assert together["false alarms on clean benches"] == "1/2"
    head, *lines = bench_study.rates([r for r in rows if r["scale"] == 1.0])
    spin = dict(zip(head, lines[1], strict=True))
    assert [spin[v] for v in ("truth", "cases", "exact", "first", "ambiguous", "nonparametric", "missed", "wrong")] == [
        "spin-up", "5", "1", "1", "1", "1", ".", "1"]  # fmt: skip
    assert "| spin-up | 5 |" in bench_study.document(rows, "the command")


def test_interrupted_study_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, ran = tmp_path / "new" / "bench.jsonl", []

    def pretend(case: BenchCase) -> Row:
        ran.append(case.key)
        return fake(case.effect, case.seed, [], scale=case.scale)

    monkeypatch.setattr(bench_study, "run_case", pretend)
    words = ["--effects", "none,spin-up", "--out", str(out), "--jobs", "1", "--scales", "1"]
    assert bench_study.main([*words, "--seeds", "1"]) == 0
    assert bench_study.main([*words, "--seeds", "2"]) == 0
    assert ran == ["none/1/1", "spin-up/1/1", "none/2/1", "spin-up/2/1"]
    assert [json.loads(x)["key"] for x in out.read_text().splitlines()] == ran
    assert "## Summary" in bench_study.report(list(read(out).values()), as_markdown)


def test_unknown_effect_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        bench_study.main(["--effects", "kraken"])
    assert leaving.value.code == 2
    assert "no effect 'kraken'; there are none, rod-flex" in capsys.readouterr().err
