"""Tests of a small fixed sample of the recovery study, and of its bookkeeping."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.ident.characterisation.thruster import THRUSTER_RATE, fit_thruster
from seatrial.ident.data.record import build_record
from seatrial.ident.diagnosis import diagnose
from seatrial.ident.effects.nonparametric import NonparametricForce
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions
from seatrial.ident.model.structure import EffectKind
from seatrial.ident.models.thruster import delayed_channels, thruster_model
from seatrial.ident.results.tables import fit_summary
from seatrial.mocks.hidden_effects.catalogue import EFFECTS, OUTSIDE
from seatrial.mocks.plant.bench import draw_bench
from tests.missions import bench_channels_of, push
from tests.recovery import study, tables, targets, verdict
from tests.recovery.cases import (
    Row,
    code_state,
    diagnose_case,
    model_of,
    ratio,
    result_of,
    run_case,
    runs_of,
    truth_of,
    z_scores,
)
from tests.recovery.kinds import KINDS, Case, all_pairs, boat_of, with_gaps
from tests.recovery.oracle import _beyond

IDENTIFIABLE = {"m_u", "m_v", "m_r", "d_v", "d_r", "d_uu", "d_vv", "d_rr", "V_x", "V_y"}


@pytest.mark.slow
def test_clean_boat_gives_no_effect_and_true_parameters() -> None:
    case = Case("none", 2, "clean")
    found = diagnose_case(case, runs_of(case, (240.0, 120.0)))
    assert found.effects == ()
    assert found.rounds == ()
    assert any(note.startswith("No effect was added. For use, take the model") for note in result_of(found).notes)
    z = z_scores(fit_summary(found.after.fit, {}).parameters, truth_of(case))
    assert set(z) >= IDENTIFIABLE
    assert {n: s for n, s in z.items() if abs(s) > 3.0} == {}


LONG = [pytest.param(e, marks=pytest.mark.study) for e in ("mismatch", "cubic-drag", "pendulum")]


@pytest.mark.parametrize("effect", LONG)
@pytest.mark.slow
def test_effect_is_named_first_and_improves_the_model(effect: str) -> None:
    row = run_case(Case(effect, 2))
    assert row.get("error") is None
    assert row["found"][:1] == [effect]
    assert row["error_ratio_without"][0] > 1.0
    assert verdict.first_right(row)
    assert row["answer"].startswith("The model lacks ")
    assert 0.9 < row["ratio"]["simulation"] < 1.1
    assert tables.position(row["after"]) < tables.position(row["before"])
    assert row["after"]["horizon"]["r"] <= 1.01 * row["before"]["horizon"]["r"]


@pytest.mark.study
def test_most_important_effect_of_a_mixture_comes_first() -> None:
    """The small delays of all effects together gain most of the likelihood. Another effect dominates the motion."""
    case = Case("turning-resistance", 1, "mixture")
    runs = runs_of(case, (240.0, 160.0))
    found = diagnose(model_of(case), runs[:1], runs[1:], max_effects=2)
    first = next(r.chosen for r in found.rounds if r.chosen is not None)
    assert first.effect.name == "delay"
    assert found.effects[0].effect.name == "turning-resistance"
    assert [w.effect for w in found.importances] == [r.effect.name for r in found.effects]
    assert found.importances[0].error_ratio > found.importances[1].error_ratio
    assert {j.effect for j in found.attributions} == {r.effect.name for r in found.effects}


@pytest.mark.study
def test_effect_is_found_beside_a_nonparametric_effect() -> None:
    """The moment with three cycles over heading gains most. The dead band is found after this curve is in the model."""
    row = run_case(Case("heading-third+dead-band", 51, "beside"))
    assert row.get("error") is None
    # This is also the order of the search. The nonparametric effect is more important.
    assert row["found"] == ["unknown N(psi)", "dead-band"]
    assert row["attribution"] == ["nonparametric", "ambiguous"]
    assert verdict.all_right(row)
    assert row["remaining_candidates"] == []


@pytest.mark.study
def test_sensor_error_outside_the_catalogue_is_drawn() -> None:
    """Without compass deviation in the catalogue, the heading error over heading is drawn, and no effect is named."""
    case = Case("compass", 2, "leave-one-out")
    runs, effects = runs_of(case, (150.0, 100.0)), {n: e for n, e in catalogue().items() if n != "compass"}
    found = diagnose(model_of(case), runs[:1], runs[1:], effects=effects, max_effects=1)
    assert [(e.effect.name, e.effect.kind) for e in found.effects] == [("unknown psi(psi)", EffectKind.NONPARAMETRIC)]
    prediction = result_of(found).prediction
    assert prediction is not None
    assert prediction.verdict == "fell"


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.study)])
def test_bench_identifies_its_thruster(seed: int) -> None:
    """Pole, thrust coefficients and delay are within three standard errors and five percent."""
    bench = draw_bench(seed)
    found = bench_channels_of(push(bench, run=1, chirp_s=5.0, count=4)[0])
    channels = delayed_channels(found["n_cmd_thruster"]) | {"n": found["n_thruster"], "force": found["force"]}
    model = thruster_model()
    record = build_record(model, channels, name="bench", rate=THRUSTER_RATE)
    fitted = fit_thruster(model, [record], EstimationOptions())
    truth = bench.truth()
    assert fitted.converged
    for name, true in (("a", "pole"), ("c1", "c1"), ("c2", "c2")):
        value, error = fitted.estimate(name)
        assert abs(value - truth[true]) < 3 * error, name
        assert value == pytest.approx(truth[true], rel=0.05), name
    assert fitted.estimate("tau")[0] == pytest.approx(truth["delay"], rel=0.05)


def fake(effect: str, seed: int, found: list[str], kind: str = "single", **more: object) -> Row:
    errors = {"horizon": dict.fromkeys(("x", "y", "r"), 3.0), "simulation": {"psi": 0.1}}
    sure = ["nonparametric" if name.startswith("unknown") else "identified" for name in found]
    return {
        "key": Case(effect, seed, kind).key,
        "effect": effect,
        "seed": seed,
        "kind": kind,
        "found": found,
        "remaining_candidates": [],
        "attribution": sure,
        "nonparametric_effects": [n.removeprefix("unknown ") for n in found if n.startswith("unknown")],
        "z": {"m_u": 2.5},
        "before": errors,
        "after": errors,
        "cpu": 1.0,
        "code": code_state(),
        "ratio": {"horizon": 1.0, "simulation": 1.02},
        **more,
    }


def test_interrupted_study_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    out, ran = tmp_path / "new" / "study.jsonl", []

    def pretend(case: Case) -> Row:
        ran.append(case.key)
        if case.key == "single/wind/2":
            return {
                "key": case.key,
                "effect": "wind",
                "kind": "single",
                "code": code_state(),
                "error": "ValueError: no",
            }
        return fake(case.effect, case.seed, list(case.truths), case.kind)

    monkeypatch.setattr(study, "run_case", pretend)
    words = ["--kinds", "single,clean", "--effects", "none,wind", "--seed", "1", "--out", str(out), "--jobs", "1"]
    assert study.main([*words, "--seeds", "1"]) == 0
    assert ran == ["single/wind/1", "clean/none/1"]
    with out.open("a", encoding="utf-8") as file:
        file.write('{"key": "none/2/1", "eff')  # The study was killed while it wrote this line.
        file.write("\n")
    assert study.main([*words, "--seeds", "2"]) == 1
    assert ran[2:] == ["single/wind/2", "clean/none/2"]
    assert study.main([*words, "--seeds", "2"]) == 1
    assert ran[4:] == ["single/wind/2"]  # The failed case is run again.
    text = capsys.readouterr().out
    assert "single/wind/1: wind (right" in text
    assert "single/wind/2: failed: ValueError: no" in text
    assert "1 of 4 cases failed" in text
    assert len([json.loads(x) for x in out.read_text().splitlines() if x.endswith("}")]) == 5
    assert study.main([*words, "--report"]) == 1  # The failed case is shown until it succeeds.
    assert "1 of 4 cases failed" in capsys.readouterr().out
    assert len(ran) == 5


def test_tables_count_the_named_effects() -> None:
    rows = [
        fake("wind", 1, ["wind"]),
        fake("wind", 2, ["compass", "wind"]),
        fake("wind", 3, []),
        fake("wind", 4, ["unknown N(psi)"]),
        fake("wind", 5, ["wind"], attribution=["ambiguous"]),
    ]
    head, line = tables.rates(rows)
    wind = dict(zip(head, line, strict=True))
    assert (wind["truth"], wind["first"], wind["found"], wind["ambiguous"]) == ("wind", "1/5", "3/5", "1/5")
    assert (wind["none"], wind["nonparametric"], wind["wrong"], wind["extra per case"]) == ("1/5", "1/5", "1/5", "0.20")
    assert wind["10 s position error, m"] == f"{np.hypot(3, 3):.3g} -> {np.hypot(3, 3):.3g}"
    head, *lines = tables.confusion(rows)
    assert [h.split()[-1] for h in head] == ["truth", "none", "wind", "compass", "nonparametric"]
    assert lines == [["wind", "1", "2", "1", "1"]]
    assert tables.coverage([fake("none", 1, [], "clean")])[1] == ["m_u", "1", "+2.50", "0.00", "0/1"]
    assert "| wind | 5 |" in study.report(rows, tables.as_markdown)


def test_targets_are_shares_of_the_right_cases() -> None:
    rows = [
        fake("none", 1, [], "clean"),
        fake("none", 2, ["wind"], "clean"),
        fake("none", 3, [], "noise-gps"),
        fake("wind+lag", 1, ["lag", "wind"], "pair"),
        fake("wind+lag", 2, ["lag"], "pair"),
        fake("yaw-saddle", 1, ["unknown N(u)"], "outside", shape=0.95),
        fake("yaw-saddle", 2, ["lift"], "outside"),
        fake("surge-step", 1, ["hump", "unknown X(u)"], "outside", attribution=["ambiguous", "nonparametric"]),
        fake("yaw-saddle+lag", 1, ["lag", "unknown N(u)"], "beside", attribution=["ambiguous", "nonparametric"]),
        fake("yaw-saddle+lag", 2, ["unknown N(u)"], "beside"),
        fake("yaw-saddle+lag", 3, ["lag"], "beside"),
        fake("wind", 1, ["current-drift"], "leave-one-out"),
        fake("wind", 2, ["current-drift"], "leave-one-out", attribution=["ambiguous"]),
    ]
    head, *lines = targets.targets(rows)
    found = {(line[0], line[1]): line[head.index("cases")] for line in lines}
    assert found[("clean", "an effect found on a clean boat")] == "1/2"
    assert found[("noise-gps", "an effect found on a clean boat with misspecified noise")] == "0/1"
    assert found[("pair", "both effects found")] == "1/2"
    assert found[("outside", "curve of the right force and variable first")] == "1/3"
    assert (
        found[("outside", "curve of the right force over the right variable, and no wrong effect first and identified")]
        == "2/3"
    )
    assert found[("outside", "true curve within the band")] == "1/3"
    assert found[("beside", "both found, the curve and the effect")] == "1/3"
    assert found[("leave-one-out", "wrong effect first, identified")] == "1/2"
    assert [line[-1] for line in lines if line[0] == "noise-gps"] == ["yes"]
    power = targets.power([fake("wind", 1, ["wind"]), fake("wind", 1, [], "half")])
    assert power[1] == ["wind", "0/1", "1/1"]
    assert targets.oracles(rows)[1][1:] == ["2", "1.000", "1.000", "1.020", "1.020"]
    assert targets.shapes(rows)[1] == ["yaw-saddle", "2", "1/2", "1", "0.95"]
    assert verdict.extra(fake("wind", 1, ["wind", "lag"])) == 1
    assert verdict.extra(fake("wind", 1, ["wind", "lag"], "mixture")) == 0


def test_kinds_have_their_effects() -> None:
    assert set(KINDS) >= {"single", "half", "mixture", "pair", "outside", "clean", "timid", "short", "dropout"}
    pairs = all_pairs(1)
    assert len(pairs) == len(EFFECTS) // 2
    assert len({name for pair in pairs for name in pair.split("+")}) == 2 * len(pairs)
    assert pairs != all_pairs(2)
    assert [e.name for e in boat_of(Case("wind+lag", 1, "pair")).effects] == ["wind", "lag"]
    assert len(boat_of(Case("wind", 1, "mixture")).effects) == len(EFFECTS)
    assert [e.name for e in boat_of(Case("none", 1, "noise-gps")).effects] == ["noise-gps"]
    assert len(study.cases_of(["outside", "clean"], 1, 2, [])) == 2 * (len(OUTSIDE) + 1)
    half = boat_of(Case("cubic-drag", 1, "half")).effects[0].parameters["k"]
    assert half == pytest.approx(0.5 * boat_of(Case("cubic-drag", 1)).effects[0].parameters["k"])


def test_dropouts_only_remove_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(KINDS, "short", replace(KINDS["short"], seconds=(70.0, 65.0)))
    whole = runs_of(Case("none", 1, "short"))[0].channels
    holed = with_gaps(dict(whole), 1)
    for name, channel in holed.items():
        kept = np.isin(whole[name].t, channel.t)
        assert 0.5 < kept.mean() < 0.96
        np.testing.assert_array_equal(channel.value, whole[name].value[kept])
    assert np.diff(holed["x"].t).max() > 5.0
    assert np.diff(holed["n_left"].t).max() < 1.0


def test_ratios_and_bands() -> None:
    assert ratio({"simulation": {"x": 2.0, "y": 0.5}}, {"simulation": {"x": 1.0, "y": 1.0}}) == {"simulation": 1.0}
    grid = np.linspace(-1.0, 1.0, 41)
    drag = NonparametricForce("X", "u", grid, grid, grid, grid, "N", "m/s")
    np.testing.assert_allclose(_beyond(drag, 3.0 + 2.0 * grid - grid * np.abs(grid)), 0.0, atol=1e-12)
    assert np.abs(_beyond(replace(drag, force="N"), 2.0 * grid)).max() > 1.0


@pytest.mark.parametrize("words", [["--effects", "kraken"], ["--kinds", "kraken"]])
def test_unknown_effect_is_a_usage_error(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        study.main(words)
    assert leaving.value.code == 2
    assert f"no {words[0][2:-1]} 'kraken'; there are " in capsys.readouterr().err
