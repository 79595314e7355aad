"""Tests of the shaft speed at n = 1: it must be the same on the bench and in the logs of the boat."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.ident.data import LoadedLog, LogSegment
from seatrial.ident.data.record import Channel
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.models.surge import surge_model
from seatrial.ident.reporter import QUIET
from seatrial.ident.workflows.full_speeds import full_speed_note, full_speed_warning
from seatrial.ident.workflows.thruster import ThrusterRequest, characterise
from tests.ident.workflows.test_thrust_scale import codes, fitted, imported, sailed
from tests.ident.workflows.test_thrust_stand_tables import FULL_RPM, pool

pytestmark = pytest.mark.usefixtures("quick_compilation")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the model.toml of a thruster whose bench log has n = 1 at 3000 rev/min."""
    folder = tmp_path_factory.mktemp("bench")
    source = pool(folder / "pool.csv")
    text = re.sub(r"scale = [\d.e-]+, hold", f'scale = "1/{FULL_RPM:.0f}", hold', guess_map(source).text)
    (folder / "map.toml").write_text(text)
    logs = import_files(folder / "map.toml", [source], out_dir=folder)
    characterise(ThrusterRequest(logs, folder / "thruster"), "test", QUIET)
    return folder / "thruster/model.toml"


@cache
def log_of(rpm: float | None, name: str = "run1") -> LoadedLog:
    c = Channel(np.arange(3.0), np.zeros(3))
    known = {} if rpm is None else {"n_left": rpm, "n_right": rpm}
    return LoadedLog(LogSegment(name, {"n_left": c, "n_right": c}), {}, {}, None, rpm_max=known)


def test_another_speed_at_n_1_than_on_the_bench_is_a_warning(bench: Path) -> None:
    """The thrust is a square of the shaft speed: (3000 / 2450)^2 = 1.5."""
    model = horizontal_model()
    assert load_model(bench).rpm_max == pytest.approx(FULL_RPM)
    found = full_speed_warning(bench, model, [log_of(3000.0), log_of(2450.0, "run2"), log_of(None)])
    assert found is not None
    assert found.code == "full-speed-differs"
    assert (
        "has n = 1 at 3000 rev/min, but the logs have it at 2450 rev/min (n_left of run2, n_right of run2)"
        in found.text
    )
    assert "masses and damping are 1.5 times their true values" in found.text
    assert "the scale 1 / 3000 in the import map" in found.text
    assert full_speed_warning(bench, model, [log_of(3001.0)]) is None
    assert full_speed_warning(None, model, [log_of(2450.0)]) is None
    assert full_speed_warning(bench, surge_model(), [log_of(2450.0)]) is None  # its input is a force


def test_an_unknown_speed_at_n_1_is_a_note_with_the_known_one(bench: Path, tmp_path: Path) -> None:
    model = horizontal_model()
    note = full_speed_note(bench, model, [log_of(3000.0), log_of(None, "run2")])
    assert (
        "n = 1 at 3000 rev/min, and the logs do not say theirs (n_left of run2, n_right of run2): n must be 1" in note
    )
    assert note.endswith("For a column in rev/min the scale in the import map is 1 / 3000.")
    assert full_speed_note(bench, model, [log_of(2450.0)]) == ""
    without = tmp_path / "model.toml"
    without.write_text(bench.read_text().replace("rpm_max = 3000.0\n", ""))
    assert "The logs have n = 1 at 2450 rev/min, and the bench result" in full_speed_note(
        without, model, [log_of(2450.0)]
    )
    assert full_speed_note(without, model, [log_of(None)]) == ""
    assert full_speed_warning(without, model, [log_of(2450.0)]) is None
    without.write_text(bench.read_text().replace("rpm_max = 3000.0\n", "rpm_max = 0.0\n"))
    with pytest.raises(SeatrialError, match=r"rpm_max = 0; it must be finite and above 0 rev/min"):
        load_model(without)


def test_a_fit_with_a_guessed_scale_names_the_number_of_the_bench(bench: Path, tmp_path: Path) -> None:
    """The largest shaft speed of the run, 2450 rev/min, was taken for the full one of the bench, 3000."""
    imported(tmp_path, "run", "[geometry]\ny_left = -0.2\ny_right = 0.2\n")
    text, table = (tmp_path / "run.toml").read_text(), sailed(120.0, 1).copy()
    table[:, -2:] *= 2450.0
    header = (tmp_path / "run.csv").read_text().partition("\n")[0]
    for side in ("left", "right"):
        header = header.replace(f"n_{side}", f"rpm_{side}")
        text = text.replace(f'column = "n_{side}"', f'column = "rpm_{side}"\nscale = "1/2450"')
    np.savetxt(tmp_path / "run.csv", table, "%.6f", ",", header=header, comments="")
    (tmp_path / "run.toml").write_text(text)
    (log,) = import_files(tmp_path / "run.toml", [tmp_path / "run.csv"], out_dir=tmp_path, force=True)
    result, output, _ = fitted(log, "--thruster", str(bench))
    assert "full-speed-differs" in codes(result)
    assert "2450 rev/min (n_left of run, n_right of run)" in " ".join(output.split())
