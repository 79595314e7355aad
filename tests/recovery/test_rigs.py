"""Tests of other rigs: their logs contain exactly the declared signals, and every line gets the right verdict."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import Esc
from seatrial.ident.data.loading import load_run
from seatrial.ident.results.parts import VehicleResult
from seatrial.ident.results.result_file import read_result
from seatrial.mocks.offline_simulation import simulate
from tests.missions import boat_with
from tests.recovery import rigs, tables
from tests.recovery.cases import Row, code_state, z_scores
from tests.recovery.logged import seatrial
from tests.recovery.resumable import read, resume
from tests.recovery.rig_logs import PLANTS, RIGS, measured_columns, navigation_filter
from tests.recovery.rigs import CHOSEN, RigCase, cases_of, verdict


@pytest.mark.parametrize("name", ["mavlink-signed", "mavlink-unsigned", "commands-5hz", "gnss-compass", "ekf"])
def test_log_of_a_rig_has_its_declared_signals(name: str, tmp_path: Path) -> None:
    rig = replace(RIGS[name], estimation=(45.0,), validation=())
    logs, _ = rig.sail(rig.boat(None, 3), tmp_path)
    loaded = load_run(logs[0], "estimation")
    found = loaded.run.channels
    assert {"psi", "x", "y", "n_left", "n_right"} <= set(found)
    assert {"gnss-compass": "r" not in found, "ekf": "u" in found}.get(name, "ax" in found)
    if name.startswith("commands"):
        assert loaded.holds["n_left"] == "zero"
        assert np.median(np.diff(found["n_left"].t)) == pytest.approx(0.2)
    if name.startswith("mavlink"):
        with open_log(logs[0]) as log:
            rpm = log.table(Esc, "autopilot", node=1)
        late = (rpm["rpm"] * rpm["duty"] < 0).any()  # The shaft has not followed a reversal yet.
        assert late == (name == "mavlink-signed")
        assert np.median(np.diff(rpm["t"])) == pytest.approx(0.04 if name == "mavlink-signed" else 0.1, rel=0.1)


def test_options_contain_the_knowledge_of_the_owner() -> None:
    boat = RIGS["vesc"].boat("wind", 1)
    assert f"c1={boat.thruster.c1!r}" in RIGS["vesc"].options(boat)
    unknown = RIGS["scale-unknown"]
    assert not any(word.startswith("c1") for word in unknown.options(unknown.boat(None, 1)))
    assert len({round(unknown.boat(None, seed).thruster.c1) for seed in range(5)}) == 5
    declared = dict(word.split("=") for word in RIGS["noise-third"].options(boat) if word.startswith("e_"))
    assert float(declared["e_r"]) == pytest.approx(0.01 / 3 / 5**0.5)


def test_navigation_filter_is_smooth_and_near_the_truth() -> None:
    done = simulate(boat_with(None, 1), [0.0, 20.0], [[0.5, 0.3], [0.2, 0.6]], 60.0, 1)
    smooth, measured, truth = navigation_filter(done.readings), measured_columns(done.readings), done.truth
    for name, near in (("psi", 0.02), ("u", 0.1), ("r", 0.03)):
        t, value = smooth[name]
        true = np.interp(t, truth["t"], np.unwrap(truth[name]) if name == "psi" else truth[name])
        if name == "u":  # This velocity is over ground.
            c, s = np.cos(np.interp(t, truth["t"], truth["psi"])), np.sin(np.interp(t, truth["t"], truth["psi"]))
            true = c * np.gradient(np.interp(t, truth["t"], truth["x"]), t) + s * np.gradient(
                np.interp(t, truth["t"], truth["y"]), t
            )
        error = value - true
        error -= 2 * np.pi * np.round(error / (2 * np.pi))
        assert np.sqrt(np.mean(error**2)) < near, name
    assert np.std(np.diff(smooth["x"][1], 2)) < 0.2 * np.std(np.diff(measured["x"][1], 2))


def row(rig: str, effect: str, found: list[str], how: str = "identified", not_excluded: tuple[str, ...] = ()) -> Row:
    return {
        "key": f"{rig}/{effect}/1", "rig": rig, "effect": effect, "seed": 1, "code": code_state(),
        "boat": RigCase(rig, effect, 1).boat_seed, "found": found,
        "attribution": [how] * len(found), "not_excluded": [list(not_excluded)] * len(found), "answer": "", "cpu": 1.0,
        "z": {"m_u": 4.0, "m_v": 1.0} if effect == "none" else {},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("line", "worth"),
    [
        (row("vesc", "none", []), rigs.RIGHT),
        (row("vesc", "none", ["wind"], "ambiguous"), rigs.FALSE_ALARM),
        (row("vesc", "wind", ["wind"]), rigs.NAMED),
        (row("vesc", "wind", ["compass"], "ambiguous", ("wind",)), rigs.LIKENED),
        # This is the form of the effect for such a model.
        (row("commands-5hz", "gnss-latency", ["gnss-latency-command"]), rigs.NAMED),
        (row("vesc", "wind", ["compass"], "ambiguous", ("mount",)), rigs.OTHER),
        (row("vesc", "wind", ["unknown N(psi)"], "nonparametric"), rigs.DRAWN),
        (row("vesc", "wind", []), rigs.MISSED),
        (row("vesc", "wind", ["wind", "lag"]), rigs.WRONG),
        (row("payload", "none", ["between-runs:payload"]), rigs.RIGHT),
        (row("payload", "wind", ["between-runs:payload"]), rigs.MISSED),
        (row("vesc", "none", ["between-runs:payload"]), rigs.FALSE_ALARM),
        (row("ekf", "none", ["filter-lag"], "ambiguous"), rigs.RIGHT),
        (row("ekf", "wind", ["filter-lag"]), rigs.MISSED),
        (row("ekf", "lever-arm", ["lever-arm", "velocity-point"]), rigs.NAMED),  # The velocity is that of the antenna.
        (row("ekf", "wind", ["wind", "velocity-point"]), rigs.WRONG),
        (row("vesc", "lever-arm", ["lever-arm", "velocity-point"]), rigs.WRONG),
        (row("vesc", "none", ["filter-lag"], "ambiguous"), rigs.FALSE_ALARM),
        (row("otter-none", "none", ["cross-flow"]), rigs.RIGHT),
        ({"key": "vesc/wind/1", "rig": "vesc", "effect": "wind", "seed": 1, "error": "ValueError: no"}, rigs.FAILED),
        (row("otter-none", "none", ["lag"]), rigs.FALSE_ALARM),
    ],
)
def test_verdict_of_a_line(line: Row, worth: str) -> None:
    assert verdict(line) == worth


def test_tables_of_the_rigs() -> None:
    rows = [row("vesc", "none", []), row("ekf", "none", ["lag"]), row("vesc", "wind", ["wind"]),
            row("ekf", "wind", []), row("otter-none", "none", []), row("ekf", "lag", []) | {"error": "no"}]  # fmt: skip
    parts = rigs.sections(rows)
    failed = rigs.asked(parts[rigs.LACKING])[1:]
    assert [line[2:] for line in failed] == [["33.3%", "6.1-79.2", "1/3", "no"], ["0.0%", "0.0-56.1", "0/3", "yes"]]
    assert rigs.asked([row("ekf", "none", []) | {"error": "no"}])[1][2:] == ["100.0%", "20.7-100.0", "1/1", "no"]
    assert {title: len(own) for title, own in parts.items()} == {rigs.CLEAN: 2, rigs.LACKING: 3, rigs.OTHERS: 1}
    clean, lacking = ([line[2:] for line in rigs.asked(parts[title][:2])[1:]] for title in (rigs.CLEAN, rigs.LACKING))
    assert clean[:2] == [["50.0%", "9.5-90.5", "1/2", "no"], ["50.0%", "15.0-85.0", "2/4", "no"]]
    worst = [line for line in rigs.asked(parts[rigs.CLEAN]) if "worst" in line[0]]
    assert [line[0].split("(")[1] for line in worst] == ["ekf)", "vesc)"]
    assert [line[4:] for line in worst] == [["1/1", "no"], ["1/2", "no"]]
    assert lacking == [["50.0%", "9.5-90.5", "1/2", "no"], ["0.0%", "0.0-65.8", "0/2", "yes"]]
    assert "What failed" in rigs.report(parts[rigs.LACKING], tables.as_text)
    assert "otter-none" in rigs.report(parts[rigs.OTHERS], tables.as_text)
    assert tables.interval(0, 300) == "0.0-1.3"


def test_failed_case_counts_until_it_is_run_again(tmp_path: Path) -> None:
    out = tmp_path / "cases.jsonl"
    cases = [RigCase("vesc", "wind", seed) for seed in (1, 2)]
    right = {case.key: row("vesc", "wind", ["wind"]) | {"key": case.key} for case in cases}
    out.write_text(json.dumps(right[cases[0].key]) + "\n" + json.dumps(right[cases[1].key] | {"error": "no"}) + "\n")
    assert [verdict(r) for r in read(out).values()] == [rigs.NAMED, rigs.FAILED]
    ran = list[str]()

    def run_case(case: RigCase) -> Row:
        ran.append(case.key)
        return right[case.key]

    assert [verdict(r) for r in resume(cases, run_case, rigs.line, 1, out)] == [rigs.NAMED, rigs.NAMED]
    assert ran == [cases[1].key]
    assert [verdict(r) for r in read(out).values()] == [rigs.NAMED, rigs.NAMED]


def test_changed_verdicts_of_repeated_cases_are_reported() -> None:
    kept = [row("vesc", "wind", ["wind"]), row("ekf", "wind", []), row("short", "wind", [])]
    assert {c.key for c in rigs.drawn(kept, 3)} == {r["key"] for r in kept}
    assert rigs.drawn(kept, 2) == rigs.drawn(kept[::-1], 2)
    state = kept[0]["code"]
    anew = f"were repeated with another state of the code ({state}; `--again 2`): the verdict is the same in"
    assert rigs.held(kept, kept[:2]) == f"2 of them, selected at random, {anew} 2 (34.2-100.0 %)."
    # The last case is not among the kept ones.
    changed = [kept[0], row("ekf", "wind", ["wind"]), row("ekf", "lag", ["lag"])]
    assert rigs.held(kept, changed).endswith(f"{anew} 1 (9.5-90.5 %): ekf/wind/1 was missed and is now identified.")
    assert rigs.held(kept, []) == ""


def test_latest_code_state_has_its_own_shares() -> None:
    old, new = row("vesc", "wind", []) | {"code": "old"}, [row("ekf", "wind", ["wind"]), row("short", "wind", [])]
    assert rigs.latest([old, *new]) == (
        f"2 of them were computed with the latest state ({code_state()}): the true effect was identified or ambiguous "
        "in 1 (9.5-90.5 %), a wrong effect was identified in 0 (0.0-65.8 %)."
    )
    clean = [row("vesc", "none", []) | {"code": "old"}, row("ekf", "none", [])]
    assert rigs.latest(clean).endswith(": no effect was found in 1 (20.7-100.0 %).")
    assert rigs.latest(new) == ""


def test_section_of_the_page_is_replaced_and_the_others_are_kept() -> None:
    page = "# Rigs\n\n## Clean boats\n\nold\n\n### Part\n\nolder\n\n## Boats with one effect\n\nkept\n"
    assert rigs.with_section(page, rigs.CLEAN, "new") == (
        "# Rigs\n\n## Clean boats\n\nnew\n\n## Boats with one effect\n\nkept\n"
    )
    assert rigs.with_section(page, rigs.LACKING, "new").endswith("older\n\n## Boats with one effect\n\nnew\n")
    assert rigs.with_section(page, rigs.OTHERS, "new") == f"{page}\n## Plants by other authors\n\nnew\n"


def test_progress_of_a_stopped_study_is_reported() -> None:
    clean, lacking = [row("vesc", "none", []), row("ekf", "none", [])], [row("vesc", "wind", ["wind"])]
    command = "    python -m tests.recovery.rigs --rigs"
    alike = "each with its own boat"
    assert rigs.how_made(clean, 2) == (
        f"{command} vesc,ekf --effects none --seed 1 --seeds 2\n\n2 of its 4 cases have been run so far, {alike}."
    )
    assert rigs.how_made(lacking, 2) == (
        f"{command} vesc --effects wind --seed 1 --seeds 2\n\n1 of its 2 cases have been run so far, {alike}."
    )
    more = rigs.how_made([*clean, row("ekf", "none", []) | {"key": "ekf/none/5", "seed": 5, "boat": 5}], 1)
    assert more == (
        f"{command} vesc,ekf --effects none --seed 1 --seeds 1\n"
        f"{command} ekf --effects none --seed 5 --seeds 1\n\n3 cases were run, {alike}."
    )
    assert rigs.how_made(clean, 1).endswith(f"\n\n2 cases were run, {alike}.")
    assert rigs.how_made([{**r, "boat": 1} for r in clean], 1).endswith("\n\n2 cases were run.")
    assert rigs.how_made([row("otter-none", "none", [])], 1).startswith(
        f"{command} otter-none\n\n1 cases were run. The estimates"
    )


def test_cases_leave_out_effects_that_a_rig_cannot_measure() -> None:
    cases = cases_of(["commands-5hz", "vesc", "otter-none"], ["none", "lag"], 7, 2)
    assert cases[0] == RigCase("otter-none", "none", 0)
    assert RigCase("vesc", "lag", 7) in cases
    assert not any(c.rig == "commands-5hz" and c.effect == "lag" for c in cases)
    assert len(cases) == 1 + 2 * 3
    assert set(PLANTS).isdisjoint(RIGS)
    every = cases_of([*RIGS], [*CHOSEN], 1, 10)
    assert len({c.boat_seed for c in every}) == len(every)


@pytest.mark.study
def test_errors_of_an_estimator_are_not_identified_as_motion(tmp_path: Path) -> None:
    """If these errors were treated as white, the quadratic yaw damping was 4.0 kg m2 (6 standard errors off) instead of
    6.06.
    """
    rig = replace(RIGS["ekf"], estimation=(250.0,), validation=())
    boat = rig.boat(None, 7002)
    logs, _ = rig.sail(boat, tmp_path)
    seatrial(
        tmp_path,
        "ident",
        "vehicle",
        logs[0].name,
        *rig.options(boat),
        "--effect",
        "filter-lag",
        "--effect",
        "velocity-lag",
        "--out",
        "found",
    )
    found = read_result(tmp_path / "found" / "result.json")
    assert isinstance(found, VehicleResult)
    z = z_scores(found.fit.parameters, rigs.truth_of(boat))
    assert len(z) >= 10
    assert max(map(abs, z.values())) < 3.5, z
    values = {p.name: p.value for p in found.fit.parameters}
    assert values["d_rr"] == pytest.approx(boat.hull.d_rr, rel=0.1)
    assert values["T_r"] == pytest.approx(0.03, abs=0.005)  # This is the time constant in `navigation_filter`.
    assert values["A_xy"] > 0.03
    assert values["tau_xy"] > 0.5


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize("rig", ["mavlink-unsigned", "commands-10hz"])
def test_clean_boat_of_another_rig_gives_no_effect_and_true_parameters(rig: str) -> None:
    """Formerly, four of four such boats with an autopilot had a false alarm, with estimates up to 5.7 standard errors
    off.
    """
    done = rigs.run_case(RigCase(rig, "none", 2))
    assert done.get("error") is None
    assert verdict(done) == rigs.RIGHT
    assert done["converged"]
    assert len(done["z"]) >= 10
    assert max(map(abs, done["z"].values())) < 3.5, done["z"]


@pytest.mark.study
def test_default_rig_is_diagnosed_by_the_commands() -> None:
    done = rigs.run_case(RigCase("vesc", "mismatch", 2))
    assert done.get("error") is None
    assert verdict(done) in (rigs.NAMED, rigs.LIKENED)
    clean = rigs.run_case(RigCase("short", "none", 2))
    assert clean.get("error") is None
    assert verdict(clean) == rigs.RIGHT


def test_readme_has_the_figures_of_the_kept_cases() -> None:
    root = Path(__file__).parents[2]
    clean, lacking = ([*read(root / f"docs/data/rigs-{name}.jsonl").values()] for name in ("clean", "effects"))
    words, z = [verdict(r) for r in lacking], [z for r in clean for z in r["z"].values()]
    readme = (root / "README.md").read_text(encoding="utf-8")
    assert {verdict(r) for r in clean} == {rigs.RIGHT}
    readme = " ".join(readme.split())
    assert f"on {len(RIGS)} kinds of rig" in readme
    assert f"{len(clean)} boats had no missing effect. In no case was an effect reported as missing." in readme
    assert f"{np.mean(np.abs(z) <= 3):.1%}".replace("%", " %") + " are within three standard errors" in readme
    assert f"{np.mean(np.abs(z) <= 1.96):.1%}".replace("%", " %") + " of the 95 % intervals contain the truth" in readme
    found = words.count(rigs.NAMED) + words.count(rigs.LIKENED)
    assert f"{len(lacking):,} boats had one of 14 effects." in readme
    assert f"In {found:,} of {len(lacking):,} cases the effect was identified or listed as likely." in readme
    assert not words.count(rigs.WRONG)
    assert "In no case was a wrong effect identified." in readme
