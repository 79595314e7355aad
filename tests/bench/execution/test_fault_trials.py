"""A sample of the fault trials, of what no other test lets fail; all of them: python -m tests.bench.fault_trials."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.bench.fault_kinds import KINDS
from tests.bench.fault_runs import Trial, trials
from tests.bench.fault_trials import MARKS, NOT_TRIED, PART, Store, into, page, parts, row, table

SAMPLE = ("VESC, temperature not told", "DroneCAN, AHRS lost", "MAVLink, capsized")


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLE)
def test_thrust_is_zero_in_time_and_the_log_says_why(name: str) -> None:
    (kind,) = [kind for kind in KINDS if kind.name == name]
    (found,) = trials(kind, [7])
    assert not found.wrong, row(kind, [found])
    assert found.said


def test_what_was_interrupted_goes_on_where_it_was(tmp_path: Path) -> None:
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
    assert "1 of 2 trials as they have to be." in written
    assert "old" not in written
    assert written.endswith(f"{MARKS[1]}\nafter\n")
    assert page(again.results, kinds).endswith("| runner killed | 350 ms | 1/2: 350, 400 (50) | - | - |")
