"""Tests of a sample of the fault trials, limited to faults that no other test injects.

The full study is `python -m tests.bench.fault_trials`.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.bench import autopilot_faults
from tests.bench.fault_kinds import KINDS
from tests.bench.fault_runs import Trial, trials
from tests.bench.fault_trials import MARKS, NOT_TRIED, PART, Store, into, page, parts, row, table

ROOT = Path(__file__).resolve().parents[3]
SAMPLE = ("VESC, temperature not reported", "DroneCAN, AHRS lost", "MAVLink, capsized")


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLE)
def test_thrust_is_zero_in_time_and_the_log_contains_the_reason(name: str) -> None:
    (kind,) = [kind for kind in KINDS if kind.name == name]
    (found,) = trials(kind, [7])
    assert not found.wrong, row(kind, [found])
    assert found.evidence


def test_an_interrupted_study_continues_where_it_stopped(tmp_path: Path) -> None:
    path, kinds = tmp_path / "trials.jsonl", KINDS[:2]
    store = Store(path)
    assert parts(kinds, PART + 1, 1, store.results) == [
        *((kind, list(range(1, PART + 1))) for kind in kinds),
        *((kind, [PART + 1]) for kind in kinds),
    ]
    store.put(kinds[0], 1, Trial(0.3, math.nan, "why"))
    store.put(kinds[0], 2, Trial(0.4, 0.05, "", ["the log does not say why"]))
    again = Store(path)
    assert again.results[kinds[0].name][2] == store.results[kinds[0].name][2]
    assert parts(kinds, 2, 1, again.results) == [(kinds[1], [1, 2])]
    assert "1/2    350    400" in table(again.results, kinds)
    assert table(again.results, kinds).endswith(NOT_TRIED)
    (tmp_path / "page.md").write_text(f"before\n{MARKS[0]}\nold\n{MARKS[1]}\nafter\n", encoding="utf-8")
    into(tmp_path / "page.md", MARKS, page(again.results, kinds))
    written = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "1 of 2 trials were correct." in written
    assert "old" not in written
    assert written.endswith(f"{MARKS[1]}\nafter\n")
    assert page(again.results, kinds).endswith("| runner killed | 350 ms | 1/2: 350, 400 (50) | - | - |")


def between(marks: tuple[str, str]) -> str:
    """Return the text of the page between these marks."""
    return (ROOT / "docs/safety.md").read_text(encoding="utf-8").partition(marks[0])[2].partition(marks[1])[0].strip()


def test_the_tables_of_the_safety_page_match_the_kept_trials() -> None:
    assert between(MARKS) == page(Store(ROOT / "docs/data/fault-trials.jsonl").results, KINDS).strip()
    rows = autopilot_faults.kept(ROOT / "docs/data/autopilot-faults.jsonl")
    assert between(autopilot_faults.MARKS) == autopilot_faults.page(rows).strip()


def test_every_fault_and_parameter_passed_on_a_real_autopilot() -> None:
    rows = autopilot_faults.kept(ROOT / "docs/data/autopilot-faults.jsonl")
    assert [row for row in rows if not row.good] == []
    settings = autopilot_faults.SETTINGS
    wanted = {(fault.name, setting.name) for fault in autopilot_faults.FAULTS for setting in settings}
    wanted |= {(f"{name} {value:g}", settings[2].name) for name, value in autopilot_faults.WRONG}
    assert {(row.fault, row.setting) for row in rows} == wanted


def test_a_trial_that_ended_for_another_reason_is_not_good() -> None:
    message = "autopilot: 1 parameter forbids to drive, yours to set: FS_ACTION is 1"
    refused = autopilot_faults.Trial("FS_ACTION 1", "", 0.0, 0.5, message, True, False)
    ended = refused._replace(
        fault="RC1_DZ 190", seconds=0.4, message="autopilot puts out n = +0.00 for thruster left, commanded"
    )
    assert refused.good
    assert ended.good
    for bad in (
        refused._replace(fault="RC_OPTIONS 34"),  # the run names another parameter as the reason
        refused._replace(seconds=0.1),  # thrust before the refusal
        refused._replace(disarmed=False),
        refused._replace(message="stopped by Ctrl-C; thrust is zero"),
        ended._replace(seconds=0.6),
        ended._replace(message="autopilot changed from mode MANUAL to HOLD"),
        refused._replace(fault="link cut", seconds=0.6),
        refused._replace(fault="link cut", disarmed=False),
    ):
        assert not bad.good, bad
