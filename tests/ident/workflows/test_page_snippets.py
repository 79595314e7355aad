"""Tests of the Python snippets in navigate.md, use-a-model.md and result.md, run with a log of commands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import seatrial.ident.results
from seatrial.daq.errors import SeatrialError
from seatrial.daq.importers.import_files import import_files
from seatrial.ident.cli.commands import ident as commands
from seatrial.ident.models.catalogue import make_model
from tests.test_docs import ROOT, blocks, how_to

T = 0.1 * np.arange(601)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write vehicle/model.toml, a model of commands, and validation.mcap, a log with commands and without shaft
    speeds.
    """
    monkeypatch.chdir(tmp_path)
    model = make_model("horizontal:command")
    sensors = ", ".join(f'"{sensor.name}"' for sensor in model.sensors)
    lines = ['format = "seatrial-model 1"', 'name = "horizontal"', 'source = "horizontal:command"']
    lines += [f"sensors = [{sensors}]", "effects = []", "[validity]", "u = [-1.0, 1.0]"]
    for parameter in model.parameters:
        lines += ["[[parameter]]", f'name = "{parameter.name}"', f"value = {float(parameter.value)!r}", "free = false"]
    (tmp_path / "vehicle").mkdir()
    (tmp_path / "vehicle/model.toml").write_text("\n".join(lines), encoding="utf-8")
    rows = [f"{t:.1f},{0.3 * np.sin(t):.4f},{0.3 * np.cos(t):.4f},0.1,{0.1 * t:.3f},{0.05 * t:.3f}" for t in T]
    (tmp_path / "run.csv").write_text("\n".join(["t,left,right,psi,x,y", *rows]) + "\n")
    signals = [f'{{ name = "{name}", column = "{name}", unit = "{unit}" }}' for name, unit in
               (("psi", "rad"), ("x", "m"), ("y", "m"))]  # fmt: skip
    signals += [f'{{ name = "n_{side}", column = "{side}", unit = "1", role = "input" }}' for side in ("left", "right")]
    (tmp_path / "map.toml").write_text(
        f'format = "seatrial-import 1"\nsignal = [{", ".join(signals)}]\ntime = {{ column = "t" }}\n'
    )
    import_files(tmp_path / "map.toml", [tmp_path / "run.csv"], out=tmp_path / "validation.mcap")
    return tmp_path


def test_navigation_with_a_log_of_commands(folder: Path) -> None:
    public, internal = (code.replace("(60.0, 90.0)", "(20.0, 30.0)") for code in blocks(how_to("navigate"), "python"))
    space: dict[str, Any] = {}
    exec(compile(public, "navigate.md", "exec"), space)
    states, done = space["states"], space["done"]
    assert any(one.withheld for one in done.result.outages)
    assert (folder / "outage/validation.csv").is_file()
    assert "seatrial." not in public  # internal modules
    exec(compile(internal, "navigate.md", "exec"), space)
    x, P = np.asarray(space["x"]), np.asarray(space["P"])
    assert x.shape[0] > 500
    assert P.shape == (*x.shape, x.shape[1])
    k = space["done"].states.index("psi")
    assert np.sqrt(P[:, k, k]).max() == pytest.approx(states["sd_psi"].max(), rel=0.01)


def test_simulation_with_a_model_of_commands(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The model has more inputs than thrusters, because it uses delayed commands."""
    words = ["export", "vehicle/model.toml", "--to", "python", "-o", "boat.py"]
    CliRunner().invoke(commands, words, catch_exceptions=False)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "boat", raising=False)  # that of another test
    space: dict[str, Any] = {}
    exec(compile(blocks(how_to("use-a-model"), "python")[0], "use-a-model.md", "exec"), space)
    boat, x = space["boat"], space["x"]
    assert len(boat.INPUTS) > 2
    assert np.all(np.isfinite(np.asarray(x, float)))


def test_result_is_read_by_the_function_that_the_page_names(folder: Path) -> None:
    assert "seatrial.ident.results.read_result(path)" in (ROOT / "docs/formats/result.md").read_text(encoding="utf-8")
    (folder / "result.json").write_text('{"kind": "nothing"}')
    for path in ("result.json", folder / "result.json"):  # A path may also be a string.
        with pytest.raises(SeatrialError, match=r"result\.json: "):
            seatrial.ident.results.read_result(path)
