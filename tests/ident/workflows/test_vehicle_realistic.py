"""Test of `seatrial ident vehicle` on a realistic boat: the errors of its sensors are estimated with the model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from seatrial import command_line
from seatrial.ident.diagnosis.common_errors import given_common_errors
from seatrial.ident.estimation import load_model
from seatrial.mocks.hidden_effects.realistic import realistic
from seatrial.mocks.plant.boat import Boat, draw_boat
from tests.missions import sail, write_log

pytestmark = pytest.mark.usefixtures("quick_compilation")

SEED = 13
THRUST = ("--prior", "c1=40.05:2", "--fix", "c2=1.11")  # the curve of a bench, known to 5 %


@pytest.fixture(scope="module")
def boat() -> Boat:
    return draw_boat(SEED, realistic(SEED))


@pytest.fixture(scope="module")
def folder(boat: Boat, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log of the boat."""
    folder = tmp_path_factory.mktemp("realistic")
    write_log(folder / "estimation.mcap", "boat", sail(boat, 160.0, 113, 1)[0].readings)
    return folder


def vehicle(folder: Path, out: str, *words: str) -> dict[str, Any]:
    """Run the command and return its result."""
    with pytest.raises(SystemExit) as left:
        command_line.main(
            [
                *("ident", "vehicle", str(folder / "estimation.mcap"), *THRUST, *words),
                *("--out", str(folder / out)),
            ]
        )
    assert not left.value.code
    read: dict[str, Any] = json.loads((folder / out / "result.json").read_text(encoding="utf-8"))
    return read


@pytest.mark.pages
@pytest.mark.slow
def test_timing_errors_are_estimated_and_the_masses_hold(boat: Boat, folder: Path) -> None:
    result = vehicle(folder, "tested")
    hidden = {e.name: e.parameters for e in boat.effects}
    found = {p["name"]: p for p in result["common_errors"]["parameters"]}
    for name, truth in (
        ("T_psi", hidden["heading-lag"]["lag"]),
        ("tau_age", hidden["telemetry-age"]["age"]),
        ("tau_gnss", hidden["gnss-latency"]["latency"]),
    ):
        assert found[name]["value"] == pytest.approx(truth, abs=0.03), name
    parameters = {p["name"]: p for p in result["fit"]["parameters"]}
    for name in ("m_u", "m_v", "m_r"):
        assert abs(parameters[name]["value"] - boat.truth()[name]) < 3 * parameters[name]["se"], name
    assert any("uncertainty of the model" in note for note in result["notes"])
    assert not any("first look" in note for note in result["notes"])
    assert "Common errors" in (folder / "tested" / "report.html").read_text(encoding="utf-8")
    # A diagnosis of this model keeps them.
    kept = given_common_errors(load_model(folder / "tested" / "model.toml").model)
    assert {e.name for e in kept} == set(result["common_errors"]["names"])
