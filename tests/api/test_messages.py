"""Tests of messages in the words of the Python interface."""

from __future__ import annotations

import ast
import importlib.util
import traceback
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest

from seatrial.api.arguments import WHOLE
from seatrial.api.messages import OF_DESIGN, OF_THRUSTER, OPTION, Messages, errors_of_users, in_python, warn_of_result
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.files import require_new
from seatrial.ident.cli.commands import design

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("give another --max-effects; --fix e_psi=0.03.", "give another max_effects; fixed={'e_psi': 0.03}."),
        ("--fix y_left=... --initial m_u=VALUE, or", "fixed={'y_left': ...}, initial={'m_u': VALUE}, or"),
        ("(--fix y_left=POSITIVE --fix y_right=-0.3)", "(fixed={'y_left': POSITIVE, 'y_right': -0.3})"),
        ("--prior c1=40:2 --fix a=1 --prior c2=8:1.", "priors={'c1': (40, 2), 'c2': (8, 1)}, fixed={'a': 1}."),
        ("run `seatrial ident diagnose` to see", "run `st.diagnose` to see"),
        ("the option `--model`", "the option `model`"),
        ("give `--fix c1=40` and --validate", "give `fixed={'c1': 40}` and validate"),
        ("`seatrial mission design MODEL --model x -o m.toml`", "`seatrial mission design MODEL --model x -o m.toml`"),
        (
            "give --prior c1=6.85:0.3, or --prior c1=MEAN:SD",
            "give priors={'c1': (6.85, 0.3)}, or priors={'c1': (MEAN, SD)}",
        ),
        ("--fix d_rr=1e-05.", "fixed={'d_rr': 1e-05}."),
        ("it exists; -o names another, as in a-o and --only", "it exists; out names another, as in a-o and --only"),
        ("import it with `seatrial import --guess '/a b/c'`", "import it with `st.import_log('/a b/c')`"),
        ("`seatrial import --guess a b`", "`st.import_log(['a', 'b'])`"),
        ("`seatrial import --guess a -o map.toml`", "`st.guess_map('a', 'map.toml')`"),
        ("`seatrial import --guess a --topic x -o map.toml`", "`seatrial import --guess a --topic x -o map.toml`"),
        ("`seatrial import map.toml FILE...`", "`st.import_log(files, 'map.toml')`"),
        ("`seatrial import map.toml a b --force`", "`seatrial import map.toml a b --force`"),
        ("`seatrial import rig.yaml a`", "`seatrial import rig.yaml a`"),
        (
            "`seatrial mission design 'my boat/model.toml' --discriminate delay,lag` generates the mission.",
            "`st.design(diagnosis, 'tell-apart.toml', between=('delay', 'lag'))` generates the mission.",
        ),
        ("`seatrial mission design --discriminate A,B`", "`seatrial mission design --discriminate A,B`"),
        ("an option --unknown stays", "an option --unknown stays"),
        (
            "the rows need --rate 10; --max-speed 1.5, --energy 0.2.",
            "the rows need rate=10; max_speed=1.5, energy=0.2.",
        ),
        ("--exclude mismatch: the model contains it", "exclude mismatch: the model contains it"),
        ("--jobs 0: give a number of processes", "jobs 0: give a number of processes"),
        ("give --rate or --settle 0.4.", "give rate or settle=0.4."),
        ("that keeps to --area 60x40", "that keeps to area=(60, 40)"),
        ("add it (--effect wind --effect gnss-latency)", "add it (effects=['wind', 'gnss-latency'])"),
        ("give --effect or --exclude NAME", "give effects or exclude=['NAME']"),
        ("--per-log F_wx --per-log F_wy.", "per_log=['F_wx', 'F_wy']."),
        ("use --model horizontal, or --model nomoto for a car", "use model='horizontal', or model='nomoto' for a car"),
        ("(--no-score-tests, in Python score_tests=False, leaves them out)", "(score_tests=False leaves them out)"),
        ("a stuck signal (seatrial check LOG).", "a stuck signal (st.check(log))."),
        ("`seatrial check 'my run.mcap'` has", "`st.check('my run.mcap')` has"),
        ("seatrial ident diagnose can find how much", "st.diagnose can find how much"),
        ("seatrial check run.mcap", "seatrial check run.mcap"),
        ("`seatrial ident vehicle --effect wind --effect lift`", "`st.fit(logs, effects=['wind', 'lift'])`"),
        (
            "`seatrial ident vehicle LOGS --model MODEL.toml --fix Y_uv=0 --no-score-tests`",
            "`st.fit(logs, model='MODEL.toml', fixed={'Y_uv': 0}, score_tests=False)`",
        ),
        (
            "`seatrial ident vehicle LOGS --effect wind --unknown x`",
            "`seatrial ident vehicle LOGS --effect wind --unknown x`",
        ),
    ],
)
def test_commands_and_options_become_functions_and_arguments(text: str, expected: str) -> None:
    assert in_python(text) == expected


def test_each_option_that_a_text_names_has_the_words_of_python() -> None:
    """A text named --rate where a user of Python needs `rate`. Options that no function has stay as they are."""
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs/site/reference.py")
    assert spec is not None
    assert spec.loader is not None
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    known = {option for function, option, argument in reference.option_names() if argument and function != "st.check"}
    named = set[str]()
    for file in (ROOT / "ident").rglob("*.py"):
        if "cli" not in file.parts:
            texts = [x.value for x in ast.walk(ast.parse(file.read_text())) if isinstance(x, ast.Constant)]
            named |= {option for text in texts if isinstance(text, str) for option in OPTION.findall(text)}
    assert {"--rate", "--max-effects", "--parameters"} <= named & known
    of_formats = {"--score-tests"}  # in the description of a field alone
    assert [option for option in sorted((named & known) - of_formats) if in_python(option) == option] == []


@pytest.mark.parametrize("kind", [SeatrialError, ValueError])
def test_an_error_in_the_words_of_python_has_one_traceback(kind: type[Exception], tmp_path: Path) -> None:
    """A user saw two tracebacks, the first with the option of the command. The frames of the computation stay."""

    def computation() -> None:
        raise kind("give another --per-log")

    with pytest.raises(SeatrialError, match="give another per_log") as found, errors_of_users():
        computation()
    shown = "".join(traceback.format_exception(found.value))
    assert shown.count("Traceback (most recent call last)") == 1
    assert "in computation" in shown
    existing = tmp_path / "boat.yaml"
    existing.touch()
    with pytest.raises(SeatrialError, match="force=True replaces it") as found, errors_of_users():
        require_new(existing, False)
    assert "".join(traceback.format_exception(found.value)).count("Traceback") == 1


def test_the_rate_of_a_design_is_that_of_sensors() -> None:
    assert in_python("or give them by --rate.", OF_DESIGN) == "or give them by rates."


def test_the_thruster_of_a_bench_is_chosen_by_its_name() -> None:
    text = "the log has left, right; give one of them as --thruster"
    assert in_python(text, OF_THRUSTER) == "the log has left, right; give one of them as name"
    assert in_python(text) == "the log has left, right; give one of them as thruster"


def test_each_warning_of_a_result_is_issued_once() -> None:
    texts = ["not used: give --model", "the data contradict the prior", "the data contradict the prior"]
    result: Any = SimpleNamespace(warnings=[SimpleNamespace(text=text) for text in texts])
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        messages = Messages(False)
        messages.warning(texts[0])
        warn_of_result(result, messages)
    assert [str(w.message) for w in issued] == ["not used: give model", "the data contradict the prior"]
    assert {w.category for w in issued} == {SeatrialWarning}


def test_whole_numbers_of_a_design_have_the_limits_of_the_command() -> None:
    options = {p.name: p.type for p in design.params if isinstance(p.type, click.IntRange)}
    for name in ("evaluations", "steps", "seed"):
        kind = options[name]
        assert isinstance(kind, click.IntRange)
        assert WHOLE[name] == (kind.min, kind.max)
