"""Tests of the group of common errors: selection of its members, initial values, and who belongs to it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from seatrial.ident.diagnosis import common_errors
from seatrial.ident.diagnosis.common_errors import (
    COMMON_ERRORS,
    SENSOR_ERRORS,
    CommonErrorScore,
    common_errors_for,
    fit_common_errors,
    nested_in,
    score_common_errors,
    with_common_errors,
    with_forms,
)
from seatrial.ident.diagnosis.findings import CommonErrorsFit, RejectedCommonErrors
from seatrial.ident.diagnosis.score_test import (
    ColumnIndex,
    NormalEquations,
    PriorTerms,
    ScoreEquations,
    SensitivityColumns,
)
from seatrial.ident.effects import catalogue
from seatrial.ident.models.catalogue import make_model
from seatrial.ident.models.horizontal import STANDARD, horizontal_model
from seatrial.ident.results.tables import common_errors_notes
from seatrial.ident.validation.prediction_errors import PredictionChange

N = 4000  # rows; the penalty of a parameter is ln 4000 = 8.3
MEMBERS = ("heading-lag", "gyro-scale", "gnss-latency", "cross-flow")


def equations(sizes: dict[str, list[float]], correlation: float = 0.0, seed: int = 1) -> ScoreEquations:
    """Return score equations of residuals that contain each member with parameters of these sizes.

    The first column is a fitted parameter. The columns of all members have the common part ``correlation``.
    """
    rng = np.random.default_rng(seed)
    effects = catalogue()
    width = [len(effects[name].parameters) for name in sizes]
    shared = rng.standard_normal((N, 1))
    columns = correlation * shared + np.sqrt(1 - correlation**2) * rng.standard_normal((N, 1 + sum(width)))
    values = np.concatenate([[0.0], *([*v] for v in sizes.values())])
    normal = NormalEquations([str(k) for k in range(columns.shape[1])])
    # An effect theta in the residuals e = noise - G theta has the score -G'e = G'G theta.
    e = rng.standard_normal(N) - columns @ values
    normal.add(range(columns.shape[1]), columns, e, np.arange(N) // 50)
    indices, first = [], 1
    for name, k in zip(sizes, width, strict=True):
        parameters = tuple(p.name for p in effects[name].parameters)
        delta = np.zeros((0, 0, k))
        indices.append(ColumnIndex(SensitivityColumns(name, delta, parameters), tuple(range(first, first + k))))
        first += k
    return ScoreEquations(normal, PriorTerms(np.zeros(1), np.zeros(1)), tuple(indices), ("m_u",))


def common(*names: str) -> dict[str, object]:
    return {name: catalogue()[name] for name in names}


@pytest.mark.parametrize(("filtered", "selected"), [(0.15, "compass-filtered"), (0.115, "compass")])
def test_heading_filter_is_selected_if_it_explains_more_than_its_parameter_costs(
    filtered: float, selected: str
) -> None:
    """The deviation without a filter is a special case, which has one parameter less."""
    name, effect = "compass-filtered", catalogue()["compass-filtered"]
    found = equations({"compass": [0.11, 0.0, 0.0, 0.0], name: [filtered, *[0.0] * 4]})
    indices = []
    for index in found.indices:  # The time constant of the filter is scanned and has no column.
        names = tuple(n for n in index.names if n not in effect.scan)
        scan = {"T_head": 8.0} if index.columns.name == name else {}
        columns = replace(index.columns, parameters=names, scan=scan, delta=np.zeros((0, 0, len(names))))
        indices.append(ColumnIndex(columns, index.at[: len(names)]))
    found = replace(found, indices=tuple(indices))
    members = score_common_errors(found, common("compass", name), N)  # type: ignore[arg-type]
    assert members.names == (selected,)
    assert members.scan == ({"T_head": 8.0} if selected == name else {})
    model = with_common_errors(horizontal_model(), (effect,), {}, 1.0, {"T_head": 8.0})
    assert model.values["T_head"] == 8.0


def test_nested_candidates_of_an_error_that_the_model_has_already_are_found() -> None:
    """A model that `ident vehicle` has fitted contains the filter, which is then no candidate itself."""
    candidates = {n: catalogue()[n] for n in ("compass", "mount")}
    assert nested_in(candidates, [catalogue()["compass-filtered"]]) == {"compass"}
    assert nested_in(common("compass-filtered", "mount"), [catalogue()["compass"]]) == {"compass-filtered"}  # type: ignore[arg-type]


def test_members_that_are_in_the_residuals_are_selected_and_others_are_not() -> None:
    sizes = {"heading-lag": [0.15], "gyro-scale": [0.0], "gnss-latency": [0.3], "cross-flow": [0.2, 0.0]}
    found = score_common_errors(equations(sizes), common(*MEMBERS), N)  # type: ignore[arg-type]
    assert found.names == ("gnss-latency", "cross-flow", "heading-lag")
    assert found.step["tau_gnss"] == pytest.approx(0.3, abs=0.05)
    assert found.step["T_psi"] == pytest.approx(0.15, abs=0.05)
    # 2 d ln L of an effect theta with unit columns is n theta^2, here less what its prior takes
    gain = N * (0.3**2 + 0.2**2 + 0.15**2) - 4 * np.log(N)
    assert found.criterion == pytest.approx(gain, rel=0.15)


def test_forms_of_hull_and_thrust_are_added_to_selected_errors() -> None:
    """Their small sizes are no reason to select them. An impossible sign is a reason to leave one out."""
    sizes = {"gnss-latency": [0.3], "cross-flow": [0.01, 0.0], "lift": [0.02, 0.0], "advance-ratio": [-0.05]}
    found = equations(sizes)
    selected = score_common_errors(found, common(*sizes), N)  # type: ignore[arg-type]
    assert selected.names == ("gnss-latency",)
    members = with_forms(selected, found, common(*sizes))  # type: ignore[arg-type]
    assert members.names == ("gnss-latency", "cross-flow", "lift")
    assert members.criterion == selected.criterion
    assert members.step["tau_gnss"] == pytest.approx(0.3, abs=0.05)
    assert set(members.step) == {p.name for n in members.names for p in catalogue()[n].parameters}


def test_correlated_members_are_judged_together() -> None:
    """A member whose column resembles that of another one is not selected if the other one explains the residuals."""
    sizes = {"gyro-scale": [0.0], "gnss-latency": [0.3]}
    found = score_common_errors(equations(sizes, correlation=0.9), common(*sizes), N)  # type: ignore[arg-type]
    assert found.names == ("gnss-latency",)


def test_a_delay_cannot_be_negative() -> None:
    sizes = {"heading-lag": [-0.3], "gyro-scale": [-0.1]}
    found = score_common_errors(equations(sizes), common(*sizes), N)  # type: ignore[arg-type]
    assert found.names == ("gyro-scale",)


def test_white_residuals_select_no_error() -> None:
    selected = 0
    for seed in range(40):
        sizes = {name: [0.0] * len(catalogue()[name].parameters) for name in MEMBERS}
        selected += bool(score_common_errors(equations(sizes, seed=seed), common(*MEMBERS), N).names)  # type: ignore[arg-type]
    # The criterion of one parameter exceeds zero with a probability of 0.4 %, of five columns with 2 %.
    assert selected <= 4


def test_initial_values_respect_bounds_and_priors() -> None:
    model = make_model("horizontal:shaft", STANDARD)
    effects = [catalogue()["heading-lag"], catalogue()["gyro-scale"]]
    started = with_common_errors(model, effects, {"T_psi": -0.1, "k_gyro": 7.0}, 1.0)
    assert started.values["T_psi"] == 0.0
    assert started.values["k_gyro"] == pytest.approx(0.1)  # one standard deviation of its prior
    assert with_common_errors(model, effects, {"k_gyro": 0.02}, 0.3).values["k_gyro"] == pytest.approx(0.006)


@pytest.mark.parametrize(("n_failures", "accepted"), [(0, True), (2, True), (3, False)])
def test_fit_with_a_likelihood_that_is_not_finite_on_the_validation_data_has_failed(
    monkeypatch: pytest.MonkeyPatch, n_failures: int, accepted: bool
) -> None:
    """It is repeated from other initial values, and without success the errors are not added."""
    steps = iter(range(3))

    class Compared:
        """Comparison whose gain is not finite for the first ``n_failures`` fits."""

        prediction = PredictionChange(0.9, 0.8, 0.95, 10.0, {})

        def __init__(self, *_: object) -> None:
            self.k = next(steps)

        @property
        def gain(self) -> tuple[float, float]:
            if self.k < n_failures:
                raise ValueError("the likelihood of these validation data is not finite")
            return 50.0, 5.0

    def fitted(model: object, *_: object, **__: object) -> Any:
        return SimpleNamespace(fit=SimpleNamespace(model=model, log_posterior=100.0))

    monkeypatch.setattr(common_errors, "fit_and_evaluate", fitted)
    monkeypatch.setattr(common_errors, "Comparison", Compared)
    current: Any = SimpleNamespace(
        fit=SimpleNamespace(model=make_model("horizontal:shaft", STANDARD), log_posterior=0.0)
    )
    records: Any = [SimpleNamespace(n_rows=100)]
    score = CommonErrorScore(("gyro-scale",), 50.0, {})
    found = fit_common_errors(current, records, [], score, common("gyro-scale"))  # type: ignore[arg-type]
    assert isinstance(found, CommonErrorsFit) == accepted
    if isinstance(found, RejectedCommonErrors):
        assert found.reason.startswith("no fit with them succeeds: the likelihood of these validation data is not fin")
        assert [e.name for e in found.effects] == ["gyro-scale"]


@pytest.mark.parametrize(
    ("estimated", "validated", "t", "prediction", "reason"),
    [
        (1000.0, 359.0, 5.7, (1.055, 1.026, 1.085), ""),
        (1000.0, 359.0, 5.7, (1.15, 1.03, 1.3), "the prediction error 10 s ahead is significantly larger with them"),
        (1000.0, 9.0, 1.5, (1.055, 1.026, 1.085), "the prediction error 10 s ahead is significantly larger with them"),
        (1000.0, 9.0, 1.5, (1.15, 0.98, 1.3), ""),
        (1000.0, -9.0, -1.5, (0.9, 0.8, 0.95), "the log-likelihood of the validation data falls by 9 with them"),
        (1.0, 359.0, 5.7, (0.9, 0.8, 0.95), "the fit gains too little by them for 1 parameter (2 Δ ln L = 2)"),
    ],
)
def test_common_errors_with_a_clear_gain_are_kept_despite_a_small_loss_of_prediction(
    monkeypatch: pytest.MonkeyPatch,
    estimated: float,
    validated: float,
    t: float,
    prediction: tuple[float, float, float],
    reason: str,
) -> None:
    """On an unstable boat an error of 10 s that rose by 5.5 % once dropped 900 ln L of timing and compass errors."""
    ratio, low, high = prediction
    compared = SimpleNamespace(gain=(validated, t), prediction=PredictionChange(ratio, low, high, 10.0, {}))
    extended = SimpleNamespace(fit=SimpleNamespace(log_posterior=estimated))
    monkeypatch.setattr(common_errors, "fit_and_evaluate", lambda *_, **__: extended)
    monkeypatch.setattr(common_errors, "Comparison", lambda *_: compared)
    before = SimpleNamespace(model=make_model("horizontal:shaft", STANDARD), log_posterior=0.0)
    score = CommonErrorScore(("gyro-scale",), 50.0, {})
    current, records = SimpleNamespace(fit=before), [SimpleNamespace(n_rows=100)]
    found = fit_common_errors(cast(Any, current), cast(Any, records), cast(Any, []), score, common("gyro-scale"))
    if reason:
        assert isinstance(found, RejectedCommonErrors)
        assert found.reason.startswith(reason)
        (note,) = common_errors_notes(None, "the model", found)
        assert f"({catalogue()['gyro-scale'].title}), because {reason}" in note
    else:
        assert isinstance(found, CommonErrorsFit)


def test_a_model_has_the_members_that_suit_its_inputs() -> None:
    for source, latency in (
        ("shaft", "gnss-latency"),
        ("command", "gnss-latency-command"),
        ("force", "gnss-latency-force"),
    ):
        model = make_model(f"horizontal:{source}", STANDARD)
        accepted = {n: e for n, e in catalogue().items() if model.accepts(e)}
        found = common_errors_for(model, accepted)
        assert latency in found
        assert ("telemetry-age" in found) == (source == "shaft")
        assert not {n for n in SENSOR_ERRORS if n.startswith("gnss-latency")} & set(found) - {latency}
        assert set(found) <= set(COMMON_ERRORS)
        extended = model
        for effect in found.values():
            extended = extended + effect
        assert not common_errors_for(extended, {n: e for n, e in accepted.items() if n not in found})


def test_members_that_a_user_replaced_or_excluded_are_left_out() -> None:
    model = make_model("horizontal:shaft", STANDARD)
    only = {"wind": catalogue()["wind"], "lift": catalogue()["lift"]}
    assert set(common_errors_for(model, only)) == {"lift", "telemetry-age"}
    assert not common_errors_for(model, {"wind": catalogue()["wind"]})
