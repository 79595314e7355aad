"""Tests of `seatrial mission design`: a mission that the bench reads, its page, and one-line errors."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec import structs

import seatrial as st
from seatrial import command_line
from seatrial.daq.config.mission_file import OperationArea, dump_mission, load_mission, parse_mission
from seatrial.daq.errors import SeatrialError
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.model_file import SavedModel, load_model
from seatrial.ident.estimation.refitted_effect import RefittedEffect
from seatrial.ident.experiment_design.criteria import SINGULAR
from seatrial.ident.experiment_design.discrimination import (
    DiscriminationDesign,
    reliable_duration,
    separation,
    separation_if_repeated,
)
from seatrial.ident.experiment_design.optimal_design import PredictedTrack
from seatrial.ident.experiment_design.prior import prior_from_fit
from seatrial.ident.experiment_design.problem import COAST_S, REST_S, DesignLimits, DesignProblem
from seatrial.ident.model.parameter import ParameterOrigin
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.thruster import thruster_model
from seatrial.ident.report import write_design_page
from seatrial.ident.reporter import QUIET, Quiet, TimeLeft
from seatrial.ident.results import DesignedParameter, DesignResult, Discrimination, read_result
from seatrial.ident.workflows import design as workflow
from seatrial.ident.workflows.design import (
    APART_PHASES,
    DesignRequest,
    _area_end,
    _design_answer,
    _design_warnings,
    _discrimination_lines,
    _enough_area,
    _size_row,
    design_summary,
    hypotheses,
    make_design,
    make_task,
    search_state,
    thrust_limit_sentence,
    warn_worse_than_baseline,
)

pytestmark = pytest.mark.usefixtures("quick_compilation")

DOCUMENT = Path(__file__).parents[3] / "docs" / "formats" / "model.md"
QUICK = ("--evaluations", "500", "--duration", "40", "--steps", "8")
# For tests of what does not depend on the model: its designs take a tenth of the time of those of a boat.
SMALL = "surge"


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Return exit status, stdout and stderr of `seatrial mission` with these words."""
    with pytest.raises(SystemExit) as left:
        command_line.main(["mission", *words])
    captured = capsys.readouterr()
    return int(left.value.code or 0), captured.out, captured.err


@pytest.fixture
def fitted(tmp_path: Path) -> Path:
    """Return the model.toml of the documentation, with a correlation of two of its parameters."""
    text = DOCUMENT.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """Design a mission for a boat. Return the mission file, stdout and stderr."""
    out = tmp_path_factory.mktemp("designed") / "mission.toml"
    words = ("design", "horizontal:shaft:no-current", *QUICK, "--slew", "2", "--n-max", "0.8", "--seed", "3")
    printed, beside = io.StringIO(), io.StringIO()
    with redirect_stdout(printed), redirect_stderr(beside), pytest.raises(SystemExit) as left:
        command_line.main(["mission", *words, "--out", str(out)])
    assert not left.value.code, beside.getvalue()
    return out, printed.getvalue(), beside.getvalue()


def test_designed_mission_is_read_by_the_bench_and_shown(
    designed: tuple[Path, str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    out, output, shown = designed
    phases = (
        "reading the model",
        "time constants",
        "compiling",
        "8 steps",
        "simulations",
        "random sequences",
        "Monte",
        "track",
    )
    places = [shown.index(words) for words in phases]
    assert places == sorted(places)
    assert "m_u ±" in output
    assert "The design assumes a built-in time constant of the shafts of 358 ms" in " ".join(output.split())
    assert "kg m²" in output
    assert "kg m2" not in output
    mission = load_mission(out)
    assert parse_mission(dump_mission(mission), "again") == mission
    assert mission.thrusters == ("left", "right")
    assert (mission.n_max, mission.slew_per_s, mission.seed) == (0.8, 2.0, 3)
    assert mission.end == pytest.approx(REST_S + 40.0)
    assert [s.name for s in mission.segments] == ["static", "designed steps"]
    assert set(mission.predicted_errors) == {"m_u", "m_v", "m_r", "d_u", "d_v", "d_r", "d_uu", "d_vv", "d_rr"}
    assert mission.prediction is not None
    assert mission.prediction.t[[0, -1]].tolist() == [0.0, mission.end + COAST_S]
    status, shown, _ = run(capsys, "show", str(out))
    assert status == 0
    assert "predicted standard errors after this mission" in shown
    area = re.search(r"predicted track .*: (\d+ m north by .* from the start)", shown)
    assert area is not None
    assert f"the track takes {area[1]}; one boat needs less." in out.with_suffix(".html").read_text(
        encoding="utf-8"
    ).replace("\u00a0", " ")
    result = json.loads(out.with_suffix(".json").read_text())
    rows = {row["name"]: row for row in result["parameters"]}
    for name, error in mission.predicted_errors.items():
        assert rows[name]["after"] == pytest.approx(error, rel=1e-3)
    assert {len(v) for v in result["samples"].values()} == {1000}
    t, n = mission.setpoints()
    at = np.searchsorted(t, np.array(result["inputs"][0]["t"][:-1]) + REST_S + 1e-6, side="right") - 1
    # Within a row, the ramps are the same.
    assert np.abs(n[at, 0] - np.array(result["inputs"][0]["value"][:-1])).max() < 0.45
    page = out.with_suffix(".html").read_text(encoding="utf-8")
    # The symbol has its own cell. Beside its meaning, it would need five lines on a phone.
    assert re.search(r'<td class="symbol[^"]*">m_u</td>', page)
    for words_ in ("Expected standard errors", "Predicted track", "Comparison with random sequences", "PRBS"):
        assert words_ in page
    assert "http://" not in re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)


@pytest.mark.parametrize(("duration", "steps"), [(40.0, 8), (240.0, 16)])  # the second one designs a block first
def test_progress_counts_all_simulations_and_has_the_time_to_go(duration: float, steps: int, tmp_path: Path) -> None:
    lines = list[str]()
    reporter: Any = SimpleNamespace(progress=lambda text, _: lines.append(text), warning=lines.append)
    request = DesignRequest(duration=duration, steps=steps, evaluations=900)
    make_design(SMALL, request, tmp_path / "m.toml", "", reporter)
    pattern = (
        r"design: (\d+) of about 900 simulations, search (\d+) of (\d+), D [-\d.]+ "
        r"\((\d+ s|\d+ min|a few seconds) to go in this phase\)"
    )
    found = [match for line in lines if (match := re.fullmatch(pattern, line))]
    counts = [int(match[1]) for match in found]
    assert len(counts) > 5
    assert counts == sorted(counts)
    assert 800 < counts[-1] < 1000
    assert found[-1][4] == "a few seconds"  # phases follow
    searches, many = [int(match[2]) for match in found], 6 if duration == 240.0 else 5
    assert {match[3] for match in found} == {str(many)}
    assert searches == sorted(searches)
    assert set(searches) == set(range(1, many + 1))


def test_each_phase_of_a_design_has_the_time_so_far(tmp_path: Path) -> None:
    lines = list[tuple[str, str]]()

    def progress(text: str, times: Callable[[], str]) -> None:
        lines.append((times(), text))

    reporter: Any = SimpleNamespace(progress=progress, warning=print)
    request = DesignRequest(duration=40.0, steps=8, evaluations=60)
    make_design("horizontal:shaft:no-current", request, tmp_path / "m.toml", "", reporter)
    assert {"design: reading the model", "design: comparison with random sequences", "design: track"} <= {
        text for _, text in lines
    }
    found = [re.fullmatch(r"\d+:\d\d so far, phase (\d) of 7", times) for times, _ in lines]
    phases = [int(match[1]) for match in found if match is not None]
    assert len(phases) == len(lines)
    assert phases == sorted(phases)
    assert set(phases) == set(range(1, 8))


def test_progress_with_few_simulations_counts_the_searches_that_follow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each search makes at least one batch, so that the first one may exceed --evaluations."""
    asked = list[tuple[float, float]]()
    monkeypatch.setattr(TimeLeft, "text", lambda _, done, least=0.0: asked.append((done, least)) or "")
    request = DesignRequest(duration=40.0, steps=8, evaluations=60)
    make_design(SMALL, request, tmp_path / "m.toml", "", QUIET)
    first = next(done for done, _ in asked if done > 60)
    assert (first, 5 * first) in asked


def test_progress_of_a_discrimination_has_the_time_to_go_of_each_phase(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All comparisons with random commands are with the same sequences, PRBS and RGS."""
    lines = list[str]()
    reporter: Any = SimpleNamespace(progress=lambda text, _: lines.append(text), warning=lines.append)

    def found_at_once(a: Model, b: Model, task: DesignProblem, **options: Any) -> DiscriminationDesign:
        z = task.steps.random(1, np.random.default_rng(1))[:, None][0]
        levels, durations = (part[..., 0] for part in task.steps.unpack(z))
        options["progress"](50, np.log(40.0), 1, 2)
        result: Any = SimpleNamespace(evaluations=50)
        return DiscriminationDesign(task, levels, durations, (50.0, 60.0), result)

    monkeypatch.setattr("seatrial.ident.workflows.design.discriminate", found_at_once)
    request = DesignRequest(duration=20.0, steps=6, between=("delay", "lag"))
    result = make_design("horizontal:shaft:no-current", request, tmp_path / "m.toml", "", reporter)
    assert (result.criterion, result.value, result.share_won, result.samples) == ("T", 50.0, None, {})
    page = (tmp_path / "m.html").read_text(encoding="utf-8")
    assert "<dt>criterion T</dt><dd>50.00</dd>" in page
    assert "of the samples" not in page
    sequences = r"best of 40 random sequences \(20 PRBS, 20 RGS\)"
    (last,) = [found for x in design_summary(result) if (found := re.match(rf"T 50\.0; {sequences}: ([\d.]+)$", x))]
    assert result.apart is not None
    assert result.apart.random.size == 40
    assert float(last[1]) == pytest.approx(result.apart.random.max(), abs=0.05)
    assert re.search(rf"<dt>{sequences}</dt>", page)
    assert "(best of 40 random sequences: " in result.answer
    assert not any(
        "random missions" in text or "best of 20" in text for text in (page, *lines, *design_summary(result))
    )
    (search,) = [line for line in lines if "comparisons, search" in line]
    assert re.search(
        r"\((\d+ (s|min)|a few seconds) to go in this phase, then random sequences for comparison\)$", search
    )
    assert not any(words in search for words in APART_PHASES[5:])  # the phase would be a later one
    assert lines.count("design: comparison with random sequences") == 1


def test_progress_has_no_criterion_while_a_limit_is_violated(tmp_path: Path) -> None:
    lines = list[str]()
    reporter: Any = SimpleNamespace(progress=lambda text, _: lines.append(text), warning=lines.append)
    request = DesignRequest(duration=40.0, steps=8, evaluations=400, limits=DesignLimits(area=(0.5, 0.5)))
    with pytest.raises(SeatrialError, match="--area"):
        make_design("horizontal:shaft:no-current", request, tmp_path / "m.toml", "", reporter)
    found = [line for line in lines if "simulations" in line]
    assert found
    for line in found:
        time = r"\((\d+ (s|min)|a few seconds) to go in this phase\)"
        assert re.search(rf", search \d of 5, no mission within the limits so far {time}$", line), line
    assert search_state(SINGULAR, "D -1e9") == "no mission so far that informs all parameters"
    assert search_state(38.2, "D 38.20") == "D 38.20"


def test_design_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mission.toml"
    status, printed, beside = run(capsys, "design", SMALL, *QUICK, "--out", str(out), "--json")
    assert status == 0
    assert "report:" in beside
    shown, result = json.loads(printed), json.loads(out.with_suffix(".json").read_text())
    assert shown["kind"] == "design"
    assert shown["parameters"] == result["parameters"]
    assert shown["samples"] == {}
    assert "t" not in shown["inputs"][0]


def test_design_that_is_worse_than_a_random_signal_is_reported_first(
    designed: tuple[Path, str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Eight steps are too few for nine parameters. Ten steps are enough for three."""
    better = ("design", "surge", "--evaluations", "1500", "--duration", "40", "--steps", "10", "--seed", "3")
    assert run(capsys, *better, "--out", str(tmp_path / "better.toml"))[0] == 0
    for out, worse in ((designed[0], True), (tmp_path / "better.toml", False)):
        result = json.loads(out.with_suffix(".json").read_text())
        assert (result["value"] < max(row["value"] for row in result["baselines"])) == worse
        assert result["answer"].startswith("The designed mission is worse than " if worse else "After this mission")
        assert ("Repeat the design with twice the --evaluations. If that changes little" in result["answer"]) == worse


@pytest.mark.parametrize(
    ("limits", "advice"),
    [
        (DesignLimits(area=(40.0, 40.0), speed=1.2), "give a larger --area or --max-speed, or a longer --duration."),
        (DesignLimits(), "give other --steps or a longer --duration."),
    ],
)
def test_a_design_that_is_worse_says_what_to_do(limits: DesignLimits, advice: str) -> None:
    problem: Any = SimpleNamespace(limits=limits)
    baseline: Any = SimpleNamespace(kind="PRBS", value=63.0)
    text = warn_worse_than_baseline(baseline, problem, "D", 60.0)
    begin = "The designed mission is worse than a random sequence"
    if limits.bind:
        begin = (
            "The limits cost information: a random sequence that ignores them is better than the designed mission, "
            "which keeps them"
        )
    assert text.startswith(
        f"{begin}: the D criterion of the mission is 60, that of the best random sequence (a PRBS) 63. "
    )
    assert text.endswith(advice)


@pytest.mark.parametrize(("value", "worse"), [(48.0, True), (51.96, False), (53.0, False)])
def test_a_design_with_limits_says_first_what_it_achieves(value: float, worse: bool) -> None:
    """Random sequences that ignore the limits came first, also if both criteria were printed as 52."""
    problem: Any = SimpleNamespace(
        limits=DesignLimits(area=(40.0, 40.0)),
        criterion="D",
        steps=SimpleNamespace(duration=240.0),
        model=horizontal_model(),
    )
    made: Any = SimpleNamespace(problem=problem, value=value)
    baseline: Any = SimpleNamespace(kind="PRBS", value=52.0)
    row: Any = SimpleNamespace(name="m_u", chosen=True, after=1.3, value=25.0, unit="kg")
    answer = _design_answer(made, [row], None, baseline)
    assert answer.startswith("After this mission of 240 s the expected standard errors are m_u ±1.3 kg (5.2 %)")
    assert ("(5.2 %). The limits cost information: a random sequence that ignores them is better" in answer) == worse
    assert not answer.endswith(".")  # the sentence on the area follows


@pytest.mark.parametrize(
    ("before", "after", "error", "said"),
    [(4.5, 4.2, 4.0, True), (4.5, 4.2, 5.5, False), (4.5, 1.0, 4.0, False), (None, None, 4.0, False)],
)
def test_an_error_that_the_thrust_limits_is_named(
    before: float | None, after: float | None, error: float, said: bool
) -> None:
    """The answer did not say that no mission can determine m_u better than its thrust scale."""
    rows = tuple(
        DesignedParameter(
            name=name, meaning="", unit=unit, value=value, before=was, after=now, form=now, baseline=now, chosen=chosen
        )
        for name, unit, value, was, now, chosen in (
            ("c1", "N", 75.7, before, after, False), ("m_u", "kg", 69.5, 4.7, error, True),
            ("d_u", "kg/s", 4.0, 4.0, 2.0, True), ("Y_r", "kg m/s", 50.0, 2.8, 2.8, False),
        )
    )  # fmt: skip
    wanted = (
        ". The thrust scale (c1 ± 5.5 %) sets this limit for m_u, so that no mission helps much more: measure the "
        "bollard pull"
    )
    for origin in ParameterOrigin:  # only a measured bollard pull can be measured better
        end = " better" if origin is ParameterOrigin.MEASURED else ""
        assert thrust_limit_sentence(rows, origin) == (f"{wanted}{end}" if said else "")
        boat = horizontal_model("shaft")
        known = boat.replace_parameters(boat.parameter("c1").known(75.7, 4.5, origin))
        problem: Any = SimpleNamespace(
            limits=DesignLimits(), criterion="D", steps=SimpleNamespace(duration=240.0), model=known
        )
        made: Any = SimpleNamespace(problem=problem, value=60.0)
        answer = _design_answer(made, rows, None, cast(Any, SimpleNamespace(kind="PRBS", value=52.0)))
        assert answer.endswith("bollard pull better") == (said and origin is ParameterOrigin.MEASURED)
        assert ("measure the bollard pull" in answer) == said


def test_the_help_of_the_area_says_that_a_boat_may_leave_it(capsys: pytest.CaptureFixture[str]) -> None:
    text = " ".join(run(capsys, "design", "--help")[1].split())
    assert "The tracks of 24 boats of the prior keep to it; your boat may leave it" in text


def test_area_that_is_enough_holds_nearly_all_boats_about_the_same_centre() -> None:
    t = np.linspace(0.0, 1.0, 5)
    reach = np.arange(1.0, 101.0)
    others = np.stack([reach[:, None] * t, 0.1 * reach[:, None] * t], axis=2)
    track = PredictedTrack(t, 10.0 * t, t, t, others, 0.3, np.array([-15.0, -10.0]))
    area = OperationArea((30.0, 20.0), (-15.0, -10.0), 0.3)
    assert _enough_area(track, area) == (200.0, 20.0)  # 95 m to the north, twice, and 5 % more
    away = replace(track, others=np.full_like(others, np.inf))
    assert _enough_area(away, area) is None


def test_an_area_that_boats_leave_has_the_area_to_design_for() -> None:
    """With 62 % of the boats inside, the answer had no option that keeps nearly all of them in the same water."""
    t = np.linspace(0.0, 1.0, 5)
    reach = np.arange(1.0, 101.0)
    others = np.stack([reach[:, None] * t, 0.1 * reach[:, None] * t], axis=2)
    track = PredictedTrack(t, 10.0 * t, t, t, others, 0.3, np.array([-15.0, -10.0]))
    limits = DesignLimits(area=(30.0, 20.0))
    assert _area_end(track, limits).endswith(
        "An area of 200 m by 20 m is large enough for this mission: the nominal boat and 95 % of the others stay in "
        "it. If you have no more room than now, design with `--area 4x20`: boats that leave that area by the same "
        "proportion stay in yours."
    )
    far = replace(track, others=others * [30.0, 1.0])  # no area of whole metres is small enough
    assert _area_end(far, limits).endswith("95 % of the others stay in it.")
    inside = replace(track, others=0.05 * others, inside=1.0)
    assert "--area" not in _area_end(inside, limits)


def test_answer_and_mission_say_whether_the_boat_stays_in_the_area(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only the page named the share of the boats that stay inside, and the mission file had no area."""
    out = tmp_path / "mission.toml"
    words = ("design", "horizontal:shaft:no-current", *QUICK, "--area", "90x80", "--out", str(out))
    status, printed, _ = run(capsys, *words)
    assert status == 0
    result = json.loads(out.with_suffix(".json").read_text())
    inside = result["track"]["inside"]
    words_of_area = (
        "The nominal boat stays in the area of 90 m north by 80 m east, and "
        f"{100 * inside:.0f} % of the boats with sampled parameters do"
    )
    assert words_of_area in result["answer"]
    assert result["answer"].endswith(".")  # the page ended without a full stop
    assert words_of_area in " ".join(printed.split())
    assert words_of_area in run(capsys, "show", str(out))[1]
    assert ("To keep more of them inside" in result["answer"]) == (inside < 0.95)
    assert ("is large enough for this mission" in result["answer"]) == (inside < 0.95)
    expected = load_mission(out).prediction
    assert expected is not None
    assert expected.area is not None
    assert expected.area.inside == pytest.approx(inside, abs=1e-4)
    assert expected.area.corner == pytest.approx(result["track"]["corner"], abs=0.01)


def test_existing_files_are_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("mission.toml", "mission.html"):
        (tmp_path / name).write_text("mine")
        status, _, err = run(capsys, "design", "horizontal", *QUICK, "--out", str(tmp_path / "mission.toml"))
        assert status == 1
        assert f"{name}: the file exists already; --force replaces it, --out names another" in err
        assert (tmp_path / name).read_text() == "mine"
        (tmp_path / name).unlink()


def test_existing_files_are_replaced_with_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mission.toml"
    for kind in (".toml", ".json", ".html"):
        out.with_suffix(kind).write_text("old")
    words = ("design", SMALL, *QUICK, "--out", str(out), "--force")
    assert run(capsys, *words)[0] == 0
    assert load_mission(out).end > 0.0
    assert json.loads(out.with_suffix(".json").read_text())["kind"] == "design"
    assert "<html" in out.with_suffix(".html").read_text()
    out.unlink()
    out.symlink_to(tmp_path / "other.toml")
    status, _, err = run(capsys, *words)
    assert status == 1
    assert "is a symbolic link" in err


def test_invalid_output_path_is_rejected_before_the_search(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The results beside a mission m.json would overwrite it."""
    (tmp_path / "file").touch()
    for name, message in (
        ("m.json", "a name that ends in .toml"),
        ("m.html", "a name that ends in .toml"),
        ("file/m.toml", "file is a file and no folder"),
    ):
        status, _, err = run(capsys, "design", "horizontal", *QUICK, "--out", str(tmp_path / name))
        assert status == 1
        assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_sensor_rates_are_those_of_the_fitted_data(fitted: Path) -> None:
    task, _ = make_task(str(fitted), DesignRequest(duration=40.0, rates={"attitude": 2.0}))
    assert {s.name: task.rate(s.name) for s in task.model.sensors} == {"attitude": 2.0, "gyro": 10.0, "position": 5.0}


@pytest.mark.parametrize(
    ("rate", "warned"), [("1", False), pytest.param("10", False, marks=pytest.mark.study), ("100", True)]
)
def test_rate_above_the_row_rate_gives_a_warning(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], rate: str, warned: bool
) -> None:
    out = tmp_path / "next.toml"
    words = ("--parameters", "m_u", "--rate", f"attitude={rate}", "--rate", "gyro=10", "--out", str(out))
    short = ("--evaluations", "500", "--duration", "20", "--steps", "4")
    assert run(capsys, "design", str(fitted), *short, *words)[0] == 0
    made = json.loads(out.with_suffix(".json").read_text())
    assert made["rates"] == {"attitude": float(rate), "gyro": 10.0, "position": 5.0}
    assert warned == any(
        "attitude 10 Hz), and the model has the noise of these data" in w["text"] for w in made["warnings"]
    )
    assert f"attitude {rate} Hz, gyro 10 Hz" in out.with_suffix(".html").read_text(encoding="utf-8")


def test_default_number_of_steps_respects_the_shortest_step() -> None:
    source = "horizontal:shaft:no-current"
    assert make_task(source, DesignRequest(duration=40.0))[0].steps.n_steps == 8
    assert make_task(source, DesignRequest(duration=40.0, shortest=7.0))[0].steps.n_steps == 5


@pytest.mark.study
def test_fitted_model_gives_its_covariance_to_the_design(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    belief = prior_from_fit(load_model(fitted))
    assert belief.names == ("m_u",)
    assert belief.covariance == pytest.approx(np.array([[0.19**2]]))
    out = tmp_path / "next.toml"
    status, output, _ = run(capsys, "design", str(fitted), *QUICK, "--parameters", "m_u", "--out", str(out))
    assert status == 0, output
    mission = load_mission(out)
    assert mission.prediction is not None
    thrust = 40.05 + 1.11  # The thrust is unknown, so the errors are divided by it.
    assert dict(mission.prediction.errors_before) == {"m_u": pytest.approx(0.19 / thrust, rel=1e-3)}
    assert mission.predicted_errors["m_u"] < 0.19 / thrust
    assert "tau_b" not in mission.predicted_errors


def test_the_shafts_have_the_time_constant_of_a_bench_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    models = {"bench": thruster_model().with_values({"a": 4.0}), "boat": horizontal_model("shaft")}
    monkeypatch.setattr(workflow, "load_model", lambda path: SimpleNamespace(model=models[path.stem]))
    request = DesignRequest(duration=60.0, steps=8, thruster=Path("bench"))
    task, _ = make_task("horizontal:shaft", request, QUIET)
    assert (task.pole, task.actuation.pole) == (4.0, 4.0)
    built_in, _ = make_task("horizontal:shaft", replace(request, thruster=None), QUIET)
    assert built_in.actuation.pole == pytest.approx(1 / 0.358, rel=0.01)
    with pytest.raises(SeatrialError, match="--thruster: the inputs of this model are commands"):
        make_task("horizontal:command", request, QUIET)
    with pytest.raises(SeatrialError, match="boat: this is no model of a thruster with a time constant"):
        make_task("horizontal:shaft", replace(request, thruster=Path("boat")), QUIET)
    out = tmp_path / "turn.toml"
    status, output, err = run(capsys, "design", "yaw", *QUICK, "--thruster", "bench", "--out", str(out))
    assert status == 0, err
    assert "time constant of the shafts" not in output


def test_one_input_is_realised_by_two_thrusters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "turn.toml"
    status, output, _ = run(capsys, "design", "yaw", *QUICK, "--out", str(out), "--thrusters", "port,star")
    assert status == 0
    assert output.index("built-in thrust of 41 N") < output.index("After this mission")
    codes = [w["code"] for w in json.loads(out.with_suffix(".json").read_text())["warnings"]]
    assert codes == ["thrust-scale-unknown", "shaft-lag-built-in", "rates-assumed"]
    assert "assumes 10 Hz for sensors whose rate neither --rate nor the model.toml gives: gyro." in " ".join(
        output.split()
    )
    mission = load_mission(out)
    assert mission.thrusters == ("port", "star")
    np.testing.assert_array_equal(mission.segments[1].n[:, 0], -mission.segments[1].n[:, 1])
    assert mission.prediction is None


@pytest.mark.study
def test_discrimination_between_two_effects(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "apart.toml"
    short = ("--evaluations", "500", "--duration", "20", "--steps", "6")
    words = ("design", "horizontal:shaft:no-current", *short, "--discriminate", "delay,lag")
    status, output, _ = run(capsys, *words, "--out", str(out))
    assert status == 0
    assert "distinguishes delay from lag: criterion T is at least" in output
    apart = json.loads(out.with_suffix(".json").read_text())["apart"]
    assert min(apart["if_first"], apart["if_second"]) > np.median(apart["random"])
    assert apart["probability"] > 0.99
    assert [(row["effect"], row["origin"]) for row in apart["sizes"]] == [("delay", "typical"), ("lag", "typical")]
    assert "delay (typical size, since no fit has one): tau_delay = 0.25 s" in " ".join(output.split())


@pytest.mark.parametrize(
    ("random", "clear", "limited", "words"),
    [
        ([20.0, 31.0, 33.0, 90.0], True, False, "T is above 30 in 3 of 4, so that any mission with varied"),
        ([20.0, 31.0, 33.0, 90.0], True, True, "Random sequences of the same length (which ignore the limits) already"),
        ([5.0, 10.0, 25.0, 90.0], True, False, ""),
        ([20.0, 31.0, 33.0, 90.0], False, True, ""),
    ],
)
def test_a_discrimination_says_that_random_sequences_are_enough(
    random: list[float], clear: bool, limited: bool, words: str
) -> None:
    """The answer did not say that the designed mission is not needed."""
    apart = Discrimination(
        effects=("delay", "lag"), if_second=200.0, if_first=150.0, clear=clear, random=np.array(random)
    )
    limits = DesignLimits(area=(60.0, 40.0)) if limited else DesignLimits()
    made: Any = SimpleNamespace(problem=SimpleNamespace(limits=limits, steps=SimpleNamespace(duration=60.0)))
    baseline: Any = SimpleNamespace(value=90.0, kind="PRBS")
    answer = _design_answer(made, [], apart, baseline)
    assert "worse than" not in answer
    baseline.value = 190.0  # T, as that of the design
    worse = "The limits cost information: a random" if limited else "The designed mission is worse"
    same = answer.replace("sequences: 90)", "sequences: 190)")
    assert _design_answer(made, [], apart, baseline).startswith(f"{same}. {worse}")
    assert ": the T criterion of the mission is 150, that of the best random" in _design_answer(
        made, [], apart, baseline
    )
    assert words in answer
    assert ("already distinguish them" in answer) == bool(words)
    # The sentence on the area begins with a full stop.
    assert _design_answer(made, [], apart, baseline).endswith("--duration.") != limited


@pytest.mark.parametrize(
    ("effects", "twice", "said"),
    [
        (("delay", "lag"), 10.0, "the same mission run twice has a T of 10: give --duration 1560 (26 min) or more"),
        (("delay", "lag"), 5.5, "so that even an hour of such missions is not enough. Other conditions may: a day on"),
        (("delay", "lag"), 5.0, "so that even an hour of such missions is not enough."),
        (
            ("wind", "steady-pull"),
            10.0,
            "(26 min) or more. A diagnosis recommends no mission for this pair, but this: mea",
        ),
        (("wind", "steady-pull"), 5.5, "not enough. What distinguishes them is this: measure the wind (an anemom"),
    ],
)
def test_a_mission_that_is_too_short_says_how_long_it_should_be(
    effects: tuple[str, str], twice: float, said: str
) -> None:
    """The advice was a longer duration, though T hardly grew with it: wind can imitate a steady pull."""
    apart = Discrimination(
        effects=effects, if_second=5.0, if_first=13.0, clear=False, random=np.array([4.0, 4.8]), twice=twice
    )
    made: Any = SimpleNamespace(problem=SimpleNamespace(limits=DesignLimits(), steps=SimpleNamespace(duration=260.0)))
    baseline: Any = SimpleNamespace(value=4.8, kind="RGS")
    answer = _design_answer(made, [], apart, baseline)
    begin = f"This mission may not distinguish {effects[0]} from {effects[1]}: criterion T is at least 5.0 (best of"
    assert answer.startswith(f"{begin} 2 random sequences: 4.8); T should be above 30, ")
    assert said in answer


def test_T_of_a_mission_that_is_run_twice_is_that_of_the_longer_mission() -> None:
    """In proportion to the duration, if neither effect can imitate the other."""
    request = DesignRequest(duration=20.0, steps=6, between=("delay", "lag"))
    task, compared = make_task("horizontal:shaft:no-current", request)
    a, b = (h.model for h in compared)
    command = task.commands(task.steps.random(1, np.random.default_rng(1)))[:, :, 0]
    once, twice = separation(a, b, task, command), separation_if_repeated(a, b, task, command)
    assert np.array(twice) / np.array(once) == pytest.approx([2.0, 2.0], rel=0.4)
    assert reliable_duration(10.0, 20.0, 100.0) == pytest.approx(300.0)
    assert reliable_duration(40.0, 80.0, 100.0) == 100.0
    assert reliable_duration(10.0, 10.0, 100.0) == np.inf


@pytest.mark.parametrize(
    ("probability", "share"), [(0.889, "of 11.1 % (guessing: 50 %"), (0.99999, "of less than 0.1 % (guessing")]
)
def test_the_probability_is_that_of_the_wrong_effect(probability: float, share: str) -> None:
    """ "The mission prefers it with a probability of 88.9 %" was read as if it were a good mission."""
    apart = Discrimination(
        effects=("delay", "lag"), if_second=3.0, if_first=9.0, clear=False, random=np.empty(0), probability=probability
    )
    assert f"a fit to this mission prefers the wrong one with a probability {share}" in apart.wrong_choice
    assert structs.replace(apart, probability=None).wrong_choice == ""


def test_a_mission_for_two_effects_says_that_it_informs_less_about_parameters(designed: tuple[Path, str, str]) -> None:
    """Nearly all standard errors were larger than those after a random sequence, without a word about it."""
    result = read_result(designed[0].with_suffix(".json"))
    assert isinstance(result, DesignResult)
    assert result.other_parameters == ""  # a design for all parameters
    first, second = result.parameters[:2]
    rows = (
        structs.replace(first, after=3.2, baseline=1.5, chosen=True),
        structs.replace(second, after=1.0, baseline=1.5, chosen=True),
    )
    apart = Discrimination(effects=("delay", "lag"), if_second=50.0, if_first=50.0, clear=True, random=np.empty(0))
    of_two = structs.replace(result, parameters=rows, apart=apart)
    said = "designed to distinguish delay from lag. It can inform less about other parameters than a random sequence: 1"
    for text in (of_two.other_parameters, " ".join(design_summary(of_two))):
        assert f"{said} of 2 standard errors are larger, that of {first.name} 2.1 times." in text
    of_one = structs.replace(
        result, parameters=(structs.replace(rows[0], chosen=False), rows[1]), chosen=(second.name,)
    )
    assert f"This mission is designed to inform about {second.name}. It" in of_one.other_parameters
    write_design_page(of_two, designed[0].with_name("two.html"))
    assert "1 of 2 standard errors are larger" in designed[0].with_name("two.html").read_text(encoding="utf-8").replace(
        "\u00a0", " "
    )


def test_a_mission_beyond_the_data_says_what_follows_and_the_limits_that_prevent_it(fitted: Path) -> None:
    """The warning named the option without its value."""
    task, _ = make_task(str(fitted), DesignRequest(duration=20.0, steps=8))
    narrow = {"n_left": (-0.4, 0.5), "n_right": (-0.45, 0.456), "u": (-0.2, 0.84)}
    task = replace(task, validity=narrow)
    levels, durations = (a[..., 0] for a in task.steps.unpack(np.ones((1, task.steps.size))))
    made: Any = SimpleNamespace(
        problem=task, command=task.actuation.limited(levels[:, :, None], durations[:, None])[:, :, 0]
    )

    def warning() -> str:
        """Return the text of the warning."""
        (text,) = [w.text for w in _design_warnings(made) if w.code == "beyond-validity"]
        return text

    text = warning()
    assert text.startswith("The mission goes beyond the data that the model was fitted to: n_left from ")
    assert "(data: -0.4 to 0.5)" in text
    assert "the boat may move faster and farther than predicted, and the promised numbers may not hold." in text
    assert text.endswith(
        "To stay nearer to the data, give --n-max 0.45 or --max-speed 0.84, or leave more room around the track."
    )
    # A limit that was given, or that nothing exceeds, is no advice.
    made.problem = replace(task, limits=DesignLimits(speed=0.84), validity=narrow)
    assert "To stay nearer to the data, give --n-max 0.45, or leave" in warning()
    made.problem = replace(task, steps=replace(task.steps, n_max=0.45), validity=narrow)
    assert "To stay nearer to the data, give --max-speed 0.84, or leave" in warning()
    # A command that is smaller by the rounding alone changes nothing.
    made.problem = replace(task, steps=replace(task.steps, n_max=0.46), validity=narrow)
    assert "To stay nearer to the data, give --max-speed 0.84, or leave" in warning()
    made.problem = replace(made.problem, validity={**narrow, "u": (-9.0, 9.0)})
    assert "To stay nearer to the data, give a smaller --n-max than 0.46, or leave" in warning()


@pytest.mark.parametrize(("n_max", "said"), [(1.0, True), (0.46, False)])
def test_commands_beyond_the_data_are_warned_of_before_the_search(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_max: float, said: bool
) -> None:
    """The warning came after the search, which takes minutes."""
    read, received = load_model, list[str]()

    class Search(Exception):
        """Begin of the search."""

    class Listener(Quiet):
        """Reporter that keeps the warnings."""

        def warning(self, text: str) -> None:
            """Keep the text."""
            received.append(text)

    def search(*_: object, **__: object) -> None:
        """Stop at the begin of the search."""
        raise Search

    narrow = {"n_left": (-0.4, 0.5), "n_right": (-0.45, 0.456), "u": (-0.2, 0.84)}
    monkeypatch.setattr(workflow, "load_model", lambda path: replace(read(path), validity=narrow))
    monkeypatch.setattr(workflow, "design", search)
    request = DesignRequest(duration=20.0, steps=8, n_max=n_max)
    with pytest.raises(Search):
        make_design(str(fitted), request, tmp_path / "mission.toml", "", Listener())
    assert received == (
        [
            "The largest command of the mission, --n-max 1, is beyond the data that the model was fitted to (n_left "
            "from -0.4 to 0.5; n_right from -0.45 to 0.46). The model is not tested there. For a mission within these "
            "commands, stop this design and give --n-max 0.45."
        ]
        if said
        else []
    )


def test_the_page_of_a_mission_begins_with_its_headline(designed: tuple[Path, str, str]) -> None:
    """Warnings stood above it."""
    page = designed[0].with_suffix(".html").read_text(encoding="utf-8")
    assert page.index("</h1>") < page.index('class="callout warning"')


def test_a_discrimination_says_before_the_search_how_long_it_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("design", "horizontal", "--out", str(tmp_path / "apart.toml"), "--discriminate", "delay,ghost")
    status, _, err = run(capsys, *words)
    assert status == 1
    assert err.index("usually takes 2 to 10 minutes; fewer --evaluations take less") < err.index("no effect 'ghost'")


def effects_of(model: Model) -> list[str]:
    return [e.name for e in model.effects]


def test_each_hypothesis_of_a_discrimination_has_only_its_own_effect() -> None:
    """In the documented use, the model already contains one effect. With it in both hypotheses, T only measured a
    prior.
    """
    fitted = (horizontal_model() + catalogue()["lag"]).with_values({"T_lag": 0.17})
    late, lagged = hypotheses(fitted, ("delay", "lag"))
    assert (effects_of(late.model), effects_of(lagged.model)) == (["delay"], ["lag"])
    assert (late.model.values["tau_delay"], late.fitted) == (0.25, False)
    assert (lagged.model.values["T_lag"], lagged.fitted) == (0.17, True)
    none_found = hypotheses(fitted.with_values({"T_lag": 0.0}), ("delay", "lag"))[1]
    assert (none_found.model.values["T_lag"], none_found.fitted) == (0.25, False)
    assert [s.name for s in late.model.states] == [s.name for s in horizontal_model().states]
    for name, none in (("hump", {"u_hump": 0.93}), ("tether", {"x_tether": 0.5}), ("mount", {"psi_mount": 1e-6})):
        unseen = (horizontal_model() + catalogue()[name]).with_values(none)
        found = hypotheses(unseen, (name, "lag"))[0]
        assert not found.fitted
        assert abs(found.model.values[catalogue()[name].parameters[0].name]) > 1e-3
    for names in (("mooring", "steady-pull"), ("lag", "lag")):
        with pytest.raises(SeatrialError, match="no mission tells them apart"):
            hypotheses(horizontal_model(), names)


def test_sizes_are_those_of_the_model_and_of_the_refits_of_its_diagnosis() -> None:
    """A refit beside the other effect tells how much is left for this one, so that it counts only without another."""
    model = (horizontal_model() + catalogue()["lag"]).with_values({"T_lag": 0.17})
    refits = (
        RefittedEffect("delay", (), {"tau_delay": 0.11}, {"tau_delay": 0.02}),
        RefittedEffect("delay", ("wind",), {"tau_delay": 0.13}, {"tau_delay": 0.03}),
        RefittedEffect("delay", ("wind", "lag"), {"tau_delay": 0.01}, {"tau_delay": 0.03}),
        RefittedEffect("mount", (), {"psi_mount": 1e-6}, {}),
    )
    saved = SavedModel(model, {"T_lag": 0.04}, {}, refits=refits)
    late, lagged = hypotheses(saved, ("delay", "lag"))
    assert (late.model.values["tau_delay"], late.errors) == (0.13, {"tau_delay": 0.03})
    assert (lagged.model.values["T_lag"], lagged.errors) == (0.17, {"T_lag": 0.04})
    mounted, other = hypotheses(saved, ("mount", "gyro-scale"))
    assert not mounted.fitted  # its fitted size is negligible
    assert not other.fitted  # no fit has it
    assert late.beside == lagged.beside == ""
    # The wind was 2 N beside turned thrusters, and a design was made for the typical size, 8 N.
    left = hypotheses(replace(saved, refits=refits[2:]), ("delay", "lag"))[0]
    assert (left.model.values["tau_delay"], left.errors, left.beside) == (0.01, {"tau_delay": 0.03}, "lag")
    assert "T_lag" not in left.model.values
    row = _size_row(left)
    assert (row.origin, row.beside) == ("fitted", "lag")
    apart: Any = SimpleNamespace(sizes=(row,), probability=None)
    assert _discrimination_lines(apart)[0].startswith("  delay (fitted size beside lag): tau_delay = 0.010 ± 0.03 s")
    assert hypotheses(replace(saved, refits=()), ("delay", "lag"))[0].errors is None


def test_typical_size_follows_the_size_of_the_boat() -> None:
    small, large = (horizontal_model().with_values({"m_u": m, "m_r": r}) for m, r in ((37.0, 10.0), (370.0, 1000.0)))
    forces = [hypotheses(m, ("yaw-bias", "lag"))[0].model.values["N_0"] for m in (small, large)]
    assert forces[1] > 5 * forces[0]


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (("horizontal", "--area", "40"), 2, "not NORTHxEAST"),
        (("horizontal", "--criterion", "Ds"), 2, "Ds needs the parameters to estimate; give them by --parameters"),
        (("horizontal", "--discriminate", "delay"), 2, "exactly two effects"),
        (("horizontal", "--parameters", "mass"), 1, "'mass' cannot be estimated"),
        (("horizontal", "--discriminate", "delay,ghost"), 1, "no effect 'ghost'"),
        (("horizontal", "--discriminate", "delay,mismach"), 1, "no effect 'mismach'; did you mean 'mismatch'?"),
        (("horizontal", "--discriminate", "delay,X(u)"), 1, "this is a curve that is fitted without a formula"),
        (("horizontal", "--rate", "sonar=1"), 1, "--rate sonar: model horizontal"),
        (("horizontal", "--thrusters", "one"), 1, "--thrusters names 1"),
        (("horizontal", "--thrusters", "left,left"), 1, "--thrusters: thrusters: names a thruster twice"),
        (("horizontal", "--steps", "100"), 1, "do not fit"),
        (("horizontal", "--rate", "position=0"), 2, "position=0: the rate has to be above 0 Hz"),
        (
            ("horizontal", "--discriminate", "delay,lag", "--average-over", "4"),
            2,
            "is not averaged over parameter samples",
        ),
        (("horizontal:shaft:no-current", "--current", "0.2"), 1, "--current cannot be simulated"),
        (("catamaran",), 1, "no model 'catamaran'"),
        (
            ("kinematic:shaft",),
            1,
            "thrusters do not produce its input phi, theta, psi, p, q, r; choose a model without",
        ),
        (("thruster",), 1, "no mission can be designed for model thruster: it describes a thruster on its bench"),
        (("none.toml",), 1, "none.toml: cannot be read: No such file"),
        (("horizontal:shaft:no-current", "--area", "1x1"), 1, "give a larger area, such as --area "),
    ],
)
def test_invalid_request_gives_a_one_line_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], status: int, message: str
) -> None:
    out = tmp_path / "m.toml"
    more = [*QUICK] if "--steps" not in words else ["--evaluations", "500", "--duration", "40"]
    got, _, err = run(capsys, "design", *words, *more, "--out", str(out))
    assert got == status
    assert message in err
    problems = [line for line in err.splitlines() if not line.startswith("  ")]  # without lines of progress
    assert status == 2 or len(problems) == 1
    assert not out.exists()


def test_help_has_an_example_and_the_group_lists_it(capsys: pytest.CaptureFixture[str]) -> None:
    status, output, _ = run(capsys, "design", "--help")
    assert status == 0
    assert "Example: seatrial mission design" in output
    assert "design" in run(capsys, "--help")[1]


RUNAWAY = '''"""Surge whose damping falls with speed: stable at full thrust, but not with a little less damping."""

from seatrial.ident.model import Input, Output, Parameter, Sensor, State
from tests.ident.toys import plain_model


def runaway():
    return plain_model(
        "runaway",
        f=lambda x, u, p: {"x": x.u, "y": 0.0, "u": p.k * u.n_cmd - p.d * x.u + x.u * x.u},
        h=lambda x, u, p: {"y": x.u},
        states=(State("x", "m"), State("y", "m"), State("u", "m/s")),
        inputs=(Input("n_cmd"),),
        sensors=(Sensor("log", (Output("y", "m/s", "e"),)),),
        parameters=(
            Parameter("k", 0.95, "m/s2"),
            Parameter("d", %s, "1/s"),
            Parameter("e", 0.05, "m/s", free=False),
        ),
    )
'''


@pytest.mark.parametrize(("damping", "unbounded"), [(2.0, True), (4.0, False)])
def test_no_track_is_predicted_if_many_simulated_boats_have_no_finite_one(
    damping: float, unbounded: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "models.py", tmp_path / "mission.toml"
    source.write_text(RUNAWAY % damping)
    words = ("design", f"{source}:runaway", "--trust-code", "--n-max", "1", "--rate", "log=10")
    status, output, err = run(capsys, *words, *QUICK, "--thrusters", "main", "--out", str(out))
    assert status == 0, err
    codes = [w["code"] for w in json.loads(out.with_suffix(".json").read_text())["warnings"]]
    assert ("track-not-predicted" in codes) == unbounded
    assert ("No track is predicted" in output) == unbounded
    assert (load_mission(out).prediction is None) == unbounded


def test_warnings_of_a_design_are_python_warnings(tmp_path: Path) -> None:
    with pytest.warns(st.SeatrialWarning) as caught:
        found = st.design("horizontal:shaft:no-current", tmp_path / "d.toml", duration=20.0, steps=5, evaluations=500)
    texts = [str(w.message) for w in caught if issubclass(w.category, st.SeatrialWarning)]
    assert {"shaft-lag-built-in", "rates-assumed"} <= {w.code for w in found.warnings}
    assert len(texts) == len(set(texts)) == len(found.warnings)
