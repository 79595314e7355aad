"""Tests of `seatrial check LOG` on measured data: real faults are found, and there are no false alarms."""

from __future__ import annotations

from pathlib import Path

import pytest

from seatrial import command_line
from seatrial.daq.checks.findings import Finding
from tests.bench.check_cases import findings
from tests.measured.data import measured, run

pytestmark = [pytest.mark.measured]

EXAMPLES = Path(__file__).resolve().parents[2] / "docs/examples"


def test_swapped_sides_of_the_blueboat_are_found(tmp_path: Path) -> None:
    files = sorted(measured("blueboat").glob("fixed_*.csv"))
    run("import", str(EXAMPLES / "blueboat/blueboat.toml"), *map(str, files), "--out-dir", str(tmp_path))
    swapped = {}
    for path in sorted(tmp_path.glob("*.mcap")):
        of_sides = [f for f in findings(path) if f.check == "sides"]
        swapped[path.stem] = [f.level for f in of_sides]
    # Some runs turn too little for a decision. All others agree.
    assert sum(levels == ["fault"] for levels in swapped.values()) >= 6, swapped
    assert not [name for name, levels in swapped.items() if levels == ["ok"]], swapped


def ferry(tmp_path: Path, thruster: int, **changes: str) -> list[Finding]:
    """Return the findings of a thruster's log. It is imported by the map of the example with some changed lines."""
    folder = measured("milliampere") / "thruster_data_test"
    text = (EXAMPLES / f"milliampere/thruster{thruster}.toml").read_text(encoding="utf-8")
    lines = text.splitlines()
    for begin, line in changes.items():
        lines = [line if old.startswith(begin) else old for old in lines]
    path = tmp_path / "map.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    files = [str(folder / f"{name}_{thruster}.csv") for name in ("actuator_ref", "motor_state")]
    with pytest.raises(SystemExit) as left:
        command_line.main(["import", str(path), *files, "-o", str(tmp_path / "log.mcap")])
    # In many rows, the time decreases.
    assert left.value.code == (1 if 'csv = { time_order = "drop" }' in lines else 0)
    return findings(tmp_path / "log.mcap")


@pytest.mark.parametrize("thruster", [3, 4])
def test_delay_limit_and_drop_outs_of_the_ferry_are_found(tmp_path: Path, thruster: int) -> None:
    found = {(f.code, f.where): f for f in reversed(ferry(tmp_path, thruster, csv="", missing=""))}
    delay = found["shaft-step-late", "pod"]
    assert delay.level == "fault"
    assert 1.5 < float(delay.text.split("only ")[1].split()[0]) < 3.0
    assert "above 0.75" in found["shaft-speed-limited", "pod"].text
    assert found["shaft-speed-drops-out", "pod"].level == "warning"
    assert ("lost-zeros-restored", "log.mcap") in found
    # The shaft follows the smallest tested command, 0.1, so there is no finding (docs/examples/milliampere).
    assert not {("dead-band-wide", "pod"), ("dead-band-narrow", "pod")} & set(found)


@pytest.mark.filterwarnings("ignore:.*left out, because times repeat")
@pytest.mark.parametrize("thruster", [3, 4])
def test_broken_time_stamps_of_the_ferry_are_found(tmp_path: Path, thruster: int) -> None:
    # This map ignores the problem: it reads a decimal fraction and drops rows with decreasing time.
    time = 'time = { column = "time", format = "%Y/%m/%d %H:%M:%S", fraction = "decimal" }'
    found = ferry(tmp_path, thruster, time=time, csv='csv = { time_order = "drop" }', missing="")
    (stamps,) = [f for f in found if f.check == "time" and "n_pod" in f.where.split(", ")]
    assert stamps.level == "fault"
    assert stamps.code == "lost-zeros"
    assert "unpadded-ns" in stamps.advice
    (rows,) = [f for f in found if f.check == "time" and f.where.startswith("motor_state")]
    assert int(rows.text.split()[0]) > 500  # These are the rows that lost their zeros, and almost no good row.
