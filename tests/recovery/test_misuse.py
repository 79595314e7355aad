"""Tests of a small part of the misuse study: every mistake is rejected by its name on one boat and rig."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from seatrial import command_line
from tests.recovery.misuse import COPY, KINDS, SENSORS, logged, outcomes, refusal, written

LONG = ("full", "position", "body")


@pytest.mark.parametrize("rig", [pytest.param(r, marks=pytest.mark.study) if r in LONG else r for r in SENSORS])
def test_mistakes_are_rejected_by_their_names(rig: str, tmp_path: Path) -> None:
    mine = [k for n, k in enumerate(KINDS) if KINDS[k].rigs[n % len(KINDS[k].rigs)] == rig]
    rows = list(outcomes([1], mine, [rig], tmp_path))
    assert [r.line for r in rows if not r.kind] == [None]
    assert [(r.kind, r.line) for r in rows if r.kind and not r.named] == []


@pytest.mark.study
@pytest.mark.parametrize("kind", ["AHRS turned by 90 deg", "AHRS turned by 180 deg", "AHRS turned by 270 deg"])
def test_fit_despite_a_turned_ahrs_ends_with_a_result_or_one_line(
    kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Formerly, these fits ended in an error of a singular value decomposition."""
    logs = [written(tmp_path / f"{k}.mcap", KINDS[kind].of(logged(1, "full", 150.0, k))) for k in (1, 2)]
    words = ["ident", "vehicle", str(logs[0]), "--validate", str(logs[1]), "--despite-faults", "--out"]
    with pytest.raises(SystemExit) as left:
        command_line.main([*words, str(tmp_path / "out")])
    out, err = capfd.readouterr()
    assert left.value.code in (0, 1)
    assert "The logs have faults that can make this result meaningless" in " ".join(out.split())
    assert "Traceback" not in err
    assert not re.search("SVD|Warning:|singular", out + err)


def test_every_kind_is_tested() -> None:
    assert len(KINDS) >= 20
    assert COPY in KINDS


def test_rejection_names_the_fault_its_place_and_the_remedy(tmp_path: Path) -> None:
    run = written(tmp_path / "run.mcap", KINDS["n in us"].of(logged(1, "position", 60.0, 1)))
    line = refusal(run, written(tmp_path / "other.mcap", logged(1, "position", 60.0, 2)))
    assert line is not None
    assert line.startswith("run.mcap: n_left: ")
    assert "[n-out-of-range]" in line
    assert "import map" in line
    assert "--despite-faults" in line
    assert "\n" not in line
