"""Tests of `ident vehicle --prior`: a sharp prior holds a parameter, a weak prior leaves it to the data, a wrong one is
rejected.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from seatrial.daq.errors import SeatrialError
from seatrial.ident.cli.commands import ident
from seatrial.ident.estimation.model_file import load_model
from tests.missions import boat_log, boat_with


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return boat_log(tmp_path_factory.mktemp("logs") / "one.mcap", boat_with(None, 5), 60, 1)


def test_prior_has_the_weight_of_its_standard_deviation(log: Path) -> None:
    found = {}
    for option in ("m_u=60:0.1", "m_u=60:40"):
        out = log.parent / option.partition(":")[2]
        words = [
            "vehicle",
            str(log),
            "--no-score-tests",
            "--fix",
            "c1=40.05",
            "--fix",
            "c2=1.11",
            "--prior",
            option,
            "--out",
            str(out),
        ]
        CliRunner().invoke(ident, words, catch_exceptions=False)
        fitted = json.loads((out / "result.json").read_text(encoding="utf-8"))["fit"]["parameters"]
        found[option] = next(p["value"] for p in fitted if p["name"] == "m_u")
        mean, _, sd = option.removeprefix("m_u=").partition(":")
        assert load_model(out / "model.toml").model.parameter("m_u").prior == (float(mean), float(sd))
        codes = [w["code"] for w in json.loads((out / "result.json").read_text(encoding="utf-8"))["warnings"]]
        assert codes == (["prior-contradicted"] if option.endswith(":0.1") else [])  # The boat has a mass of 37 kg.
    assert found["m_u=60:0.1"] == pytest.approx(60.0, abs=1.0)
    assert found["m_u=60:40"] < 50.0  # The boat has a mass of 37 kg.


@pytest.mark.parametrize(
    ("option", "message"),
    [("mass=1:2", "--prior mass: model horizontal has"), ("m_u=-1:2", "--prior m_u=-1:2: parameter m_u")],
)
def test_impossible_prior_is_rejected(log: Path, option: str, message: str) -> None:
    done = CliRunner().invoke(ident, ["vehicle", str(log), "--no-score-tests", "--prior", option])
    assert isinstance(done.exception, SeatrialError)
    assert message in str(done.exception)


@pytest.mark.parametrize("option", ["m_u=1", "m_u=1:0", "m_u=a:b", "m_u=1:2:3"])
def test_malformed_prior_is_a_usage_error(log: Path, option: str) -> None:
    done = CliRunner().invoke(ident, ["vehicle", str(log), "--no-score-tests", "--prior", option])
    assert done.exit_code == 2
    assert option in done.output


@pytest.mark.parametrize("times", [0.33, 1.0, 3.0])
def test_given_noise_is_estimated_if_the_residuals_contradict_it(log: Path, times: float) -> None:
    """A noise fixed at a third of its value shifts the estimates by ten standard errors."""
    noise = {"e_psi": 0.0039, "e_r": 0.0045, "e_a": 0.045, "e_xy": 0.15, "e_vxy": 0.05}
    options = [word for n, sd in noise.items() for word in ("--fix", f"{n}={times * sd}")]
    out = log.parent / f"noise{times}"
    words = [
        "vehicle",
        str(log),
        "--no-score-tests",
        "--fix",
        "c1=40.05",
        "--fix",
        "c2=1.11",
        *options,
        "--out",
        str(out),
    ]
    CliRunner().invoke(ident, words, catch_exceptions=False)
    warnings = json.loads((out / "result.json").read_text(encoding="utf-8"))["warnings"]
    contradicted, model = times < 1.0, load_model(out / "model.toml").model
    assert {w["code"] for w in warnings} == ({"noise-contradicted"} if contradicted else set())
    for name, sd in noise.items():
        assert model.parameter(name).free is contradicted
        assert model.values[name] == pytest.approx(sd if contradicted else times * sd, rel=0.2)
