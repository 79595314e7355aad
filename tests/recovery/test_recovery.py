"""A small fixed sample of the recovery study, and the study's own book-keeping."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ident import bench_job
from ident.bench_job import first_guess
from ident.dataset import build_record
from ident.models.thruster import delayed_channels, thruster
from mocks.bench_plant import draw_bench
from tests.missions import bench_channels_of, push
from tests.recovery import study, tables
from tests.recovery.cases import NAMES, Case, Row, diagnose_case, run_case, truth_of, z_scores

IDENTIFIABLE = {"m_u", "m_v", "m_r", "d_v", "d_r", "d_uu", "d_vv", "d_rr", "V_x", "V_y"}


@pytest.mark.slow
def test_a_clean_boat_lacks_nothing_and_its_parameters_are_true() -> None:
    case = Case("none", 2)
    found = diagnose_case(case)
    assert found.effects == ()
    assert found.rounds == ()
    z = z_scores(found.after, truth_of(case))
    assert set(z) >= IDENTIFIABLE
    assert {n: s for n, s in z.items() if abs(s) > 3.0} == {}


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["mismatch", "cubic-drag", "pendulum"])
def test_an_effect_is_named_first_and_makes_the_model_better(effect: str) -> None:
    row = run_case(Case(effect, 2))
    assert row.get("error") is None
    assert row["found"][:1] == [effect]
    assert tables.position(row["after"]) < tables.position(row["before"])
    assert row["after"]["ten_seconds"]["r"] <= 1.01 * row["before"]["ten_seconds"]["r"]


@pytest.mark.parametrize("seed", [1, 2])
def test_the_bench_finds_its_thruster(seed: int) -> None:
    """Pole, thrust coefficients and delay within three standard errors and five percent."""
    bench = draw_bench(seed)
    found = bench_channels_of(push(bench, run=1)[0])
    channels = delayed_channels(found["n_cmd_thruster"]) | {"n": found["n_thruster"], "force": found["force"]}
    model = thruster()
    record = build_record(model, channels, name="bench", rate=bench_job.RATE)
    fitted = bench_job._fit(model, [record], first_guess([record], has_force=True))
    truth = bench.truth()
    assert fitted.converged
    for name, true in (("a", "pole"), ("c1", "c1"), ("c2", "c2")):
        value, error = fitted.estimate(name)
        assert abs(value - truth[true]) < 3 * error, name
        assert value == pytest.approx(truth[true], rel=0.05), name
    assert fitted.estimate("tau")[0] == pytest.approx(truth["delay"], rel=0.05)


def fake(effect: str, seed: int, found: list[str], **more: object) -> Row:
    errors = {"ten_seconds": dict.fromkeys(("x", "y", "r"), 3.0), "free_run": {"psi": 0.1}}
    return {
        "key": Case(effect, seed).key, "effect": effect, "seed": seed, "scale": 1.0, "found": found, "left": [],
        "z": {"m_u": 2.5}, "before": errors, "after": errors, "cpu": 1.0, "code": study.code_state(), **more,
    }


def test_a_study_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    out, ran = tmp_path / "new" / "study.jsonl", []

    def pretend(case: Case) -> Row:
        ran.append(case.key)
        if case.key == "wind/2/1":
            return {"key": case.key, "effect": "wind", "code": study.code_state(), "error": "ValueError: no"}
        return fake(case.effect, case.seed, [] if case.effect == "none" else [case.effect])

    monkeypatch.setattr(study, "run_case", pretend)
    words = ["--effects", "none,wind", "--seed", "1", "--out", str(out), "--jobs", "1"]
    assert study.main([*words, "--seeds", "1"]) == 0
    assert ran == ["none/1/1", "wind/1/1"]
    with out.open("a", encoding="utf-8") as file:
        file.write('{"key": "none/2/1", "eff')  # killed while it wrote
        file.write("\n")
    assert study.main([*words, "--seeds", "2"]) == 1
    assert ran[2:] == ["none/2/1", "wind/2/1"]
    assert study.main([*words, "--seeds", "2"]) == 1
    assert ran[4:] == ["wind/2/1"]  # what failed is tried again
    text = capsys.readouterr().out
    assert "wind/1/1: wind (right" in text
    assert "wind/2/1: failed: ValueError: no" in text
    assert len([json.loads(x) for x in out.read_text().splitlines() if x.endswith("}")]) == 5


def test_the_tables_count_what_was_named() -> None:
    rows = [
        fake("wind", 1, ["wind"]), fake("wind", 2, ["compass", "wind"]), fake("wind", 3, []),
        fake("wind", 4, ["unknown N(psi)"]), fake("none", 1, []), fake("none", 2, ["wind"]),
    ]
    head, *lines = tables.rates(rows)
    clean, wind = (dict(zip(head, x, strict=True)) for x in lines)
    assert (wind["truth"], wind["first"], wind["among"]) == ("wind", "1/4", "2/4")
    assert (wind["none"], wind["unknown"], wind["wrong"], wind["extra a case"]) == ("1/4", "1/4", "1/4", "0.50")
    assert (clean["first"], clean["wrong"]) == ("1/2", "1/2")
    assert wind["10 s position error, m"] == f"{np.hypot(3, 3):.3g} -> {np.hypot(3, 3):.3g}"
    together = dict(map(tuple, tables.summary(rows)))
    assert together["named first"] == "1/4"
    assert together["false alarms on clean boats"] == "1/2"
    assert together["extra names a case"] == "0.50"
    head, *lines = tables.confusion(rows)
    assert [h.split()[-1] for h in head] == ["truth", "none", "wind", "compass", "unknown"]
    assert lines[1] == ["wind", "1", "1", "1", "1"]
    assert tables.coverage(rows)[1] == ["m_u", "2", "+2.50", "0.00", "0/2"]
    assert "| wind | 4 |" in study.report(rows, tables.as_markdown)
    assert NAMES[0] == "none"
    assert len(NAMES) == 16


def test_an_unknown_effect_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        study.main(["--effects", "kraken"])
    assert leaving.value.code == 2
    assert "no effect 'kraken'; there are none, advance-ratio" in capsys.readouterr().err
