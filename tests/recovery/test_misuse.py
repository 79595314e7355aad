"""A small cut of the misuse study: every mistake on one boat and rig is refused by its name."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.recovery.misuse import COPY, KINDS, SENSORS, logged, outcomes, refusal, written

LONG = ("full", "position", "body")


@pytest.mark.parametrize("rig", [pytest.param(r, marks=pytest.mark.study) if r in LONG else r for r in SENSORS])
def test_mistakes_are_refused_by_their_names(rig: str, tmp_path: Path) -> None:
    mine = [k for n, k in enumerate(KINDS) if KINDS[k].rigs[n % len(KINDS[k].rigs)] == rig]
    rows = list(outcomes([1], mine, [rig], tmp_path))
    assert [r.line for r in rows if not r.kind] == [None]
    assert [(r.kind, r.line) for r in rows if r.kind and not r.named] == []


def test_every_kind_is_in_the_cut() -> None:
    assert len(KINDS) >= 20
    assert COPY in KINDS


def test_a_line_says_what_where_and_what_to_write(tmp_path: Path) -> None:
    run = written(tmp_path / "run.mcap", KINDS["n in us"].of(logged(1, "position", 60.0, 1)))
    line = refusal(run, written(tmp_path / "other.mcap", logged(1, "position", 60.0, 2)))
    assert line is not None
    assert line.startswith("run.mcap: n_left: ")
    assert "[n-out-of-range]" in line
    assert "import's map" in line
    assert "--despite-faults" in line
    assert "\n" not in line
