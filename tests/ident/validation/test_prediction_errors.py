"""Tests of prediction errors: one step ahead, over a horizon and in simulation, against independently solved
equations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from seatrial.ident.data.record import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Output, Sensor, State, plain_model
from seatrial.ident.numerics.signal_processing import wrap
from seatrial.ident.validation.prediction_errors import (
    WARM_UP,
    PredictionErrors,
    concentrated_errors,
    correlated_blocks,
    horizon_errors,
    largest_errors,
    one_step_errors,
    pooled_errors,
    prediction_change,
    prediction_change_by_record,
    simulation_run,
    without_spans,
)
from tests.ident.sliders import D, M, slide, slider
from tests.ident.toys import turning, turning_record, values_of

MODEL = slider()
VALUES = values_of(MODEL)


def solved(record: Record, x: np.ndarray, first: int, last: int) -> np.ndarray:
    """Return the slider's state at row ``last`` from ``x`` at row ``first``. The input is held over each row."""
    for k in range(first, last):
        w = record.u[k, 0]
        span = (record.t[k], record.t[k + 1])
        x = solve_ivp(lambda _, z, w=w: [z[1], (w - D * z[1]) / M], span, x, rtol=1e-10, atol=1e-12).y[:, -1]
    return x


def test_one_step_errors_equal_the_innovations() -> None:
    """The first sample of a channel has no sample before it, and is not counted."""
    record, model = turning_record(), turning()
    run = Likelihood(model).filter(record, values_of(model))
    found = one_step_errors(model, record, run)
    assert list(found) == ["psi", "gyro", "second"]
    later = np.flatnonzero(np.isfinite(record.y[:, 0]))[1:]
    np.testing.assert_array_equal(found["psi"].t, record.t[later])
    np.testing.assert_array_equal(found["psi"].e, run.e[later, 0])
    nothing = replace(record, y=np.where(np.arange(3) == 0, np.nan, record.y))
    assert list(one_step_errors(model, nothing, Likelihood(model).filter(nothing, values_of(model)))) == [
        "gyro",
        "second",
    ]


@pytest.mark.parametrize("seconds", [10.0, 1.5])
def test_horizon_prediction_equals_the_solution_from_the_filtered_state(seconds: float) -> None:
    record = slide(1, 300)
    run = Likelihood(MODEL).filter(record, VALUES)
    found = horizon_errors(MODEL, record, VALUES, run.x_filt, seconds)
    assert set(found) == {"speed", "place"}
    assert found["speed"].t[0] == pytest.approx(seconds)
    assert found["speed"].t[-1] <= record.t[-1]
    for k in (0, 40, 150):
        last = int(np.searchsorted(record.t, record.t[k] + seconds - 1e-6))
        x = solved(record, run.x_filt[k], k, last)
        at = np.searchsorted(found["speed"].t, record.t[last] - 1e-9)
        assert found["speed"].e[at] == pytest.approx(record.y[last, 0] - x[1], abs=1e-6)
        if np.isfinite(record.y[last, 1]):
            at = np.searchsorted(found["place"].t, record.t[last] - 1e-9)
            assert found["place"].e[at] == pytest.approx(record.y[last, 1] - x[0], abs=1e-6)


def test_simulation_uses_only_its_first_seconds_of_measurements() -> None:
    record = slide(2, 400)
    free = simulation_run(MODEL, record, VALUES)
    blind = record.t > WARM_UP
    changed = record.y.copy()
    changed[blind] += 5.0
    np.testing.assert_array_equal(simulation_run(MODEL, replace(record, y=changed), VALUES).y, free.y)
    assert free.errors["speed"].t[0] > WARM_UP
    last = int(np.flatnonzero(~blind)[-1])
    run = Likelihood(MODEL).filter(replace(record, y=np.where(blind[:, None], np.nan, record.y)), VALUES)
    x = solved(record, run.x_filt[last], last, record.n_rows - 1)
    np.testing.assert_allclose(free.y[-1], [x[1], x[0]], atol=1e-6)
    assert free.errors["speed"].e[-1] == pytest.approx(record.y[-1, 0] - x[1], abs=1e-6)
    seen = record.y[blind, 0]
    assert free.errors["speed"].spread == pytest.approx(seen[np.isfinite(seen)].std())


def test_simulated_speed_stays_bounded_if_the_heading_is_lost() -> None:
    """With a heading spread over the whole circle, the second-order series of its cosine can give any speed."""
    model = plain_model(
        "adrift",
        f=lambda x, u, p: {"x": np.cos(x.psi), "psi": p.turn},
        h=lambda x, u, p: {"x": x.x, "psi": x.psi},
        states=(State("x", "m", from_output="x", sd0=0.1), State("psi", "rad", "", "s", from_output="psi", sd0=0.1)),
        inputs=(),
        sensors=(Sensor("all", (Output("x", "m", "e"), Output("psi", "rad", "e", angle=True))),),
        parameters=(Parameter("s", 0.5), Parameter("e", 0.05), Parameter("turn", 0.1)),
    )
    t, psi = np.arange(0.0, 200.0, 0.1), 0.1 * np.arange(0.0, 200.0, 0.1)
    y, none = np.column_stack([np.sin(psi) / 0.1, psi]), np.empty((t.size, 0))
    record = Record("lost", t, none, none, y, (), ("x", "psi"))
    bent = replace(model, second_order=True)
    free = simulation_run(bent, record, values_of(bent), Likelihood(bent))
    assert np.abs(np.diff(free.y[:, 0])).max() < 0.11
    # The boat moves on a circle of 10 m. The last measured heading shifts its centre.
    assert free.errors["x"].rms < 25.0


def test_band_of_a_simulation_covers_the_errors() -> None:
    """Over many runs, 95 % of the errors lie within 1.96 standard deviations, at all times."""
    inside = []
    for seed in range(40):
        record = slide(100 + seed, 400)
        free = simulation_run(MODEL, record, VALUES, Likelihood(MODEL))
        rows = np.flatnonzero((record.t > WARM_UP) & np.isfinite(record.y[:, 1]))
        inside.append(np.abs(record.y[rows] - free.y[rows]) < 1.96 * free.sd[rows])
    rate = np.mean(inside, axis=0)  # Dimensions: rows, channels.
    assert rate.mean() == pytest.approx(0.95, abs=0.03)
    assert rate[-5:].mean() == pytest.approx(0.95, abs=0.06)


def test_angles_are_wrapped() -> None:
    np.testing.assert_allclose(
        wrap(np.array([3.5, -3.5, 0.1, 6.3]), True), [3.5 - 2 * np.pi, 2 * np.pi - 3.5, 0.1, 6.3 - 2 * np.pi]
    )
    np.testing.assert_array_equal(wrap(np.array([3.5]), False), [3.5])
    record, model = turning_record(n_rows=400), turning()
    free = simulation_run(model, record, values_of(model))
    assert np.abs(free.errors["psi"].e).max() <= np.pi


def test_pooled_errors_keep_records_separate_in_time() -> None:
    a = PredictionErrors(np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([1.0, -1.0]))
    b = PredictionErrors(np.array([0.5, 1.5]), np.array([0.0, 0.0]), np.array([3.0, -3.0]))
    found = pooled_errors([{"x": a, "r": b}, {"x": b}])
    assert found["x"].e.tolist() == [3.0, 4.0, 0.0, 0.0]
    assert (np.diff(found["x"].t) > 0).all()
    assert found["x"].rms == pytest.approx(2.5)
    assert found["x"].spread == pytest.approx(np.sqrt(5.0))
    assert found["r"].e.size == 2
    assert np.isnan(PredictionErrors(np.zeros(0), np.zeros(0)).rms)


def moving_average(rng: np.random.Generator, n: int, width: int) -> np.ndarray:
    """Return errors that are correlated over a horizon of ``width`` samples."""
    return np.convolve(rng.normal(size=n + width - 1), np.full(width, width**-0.5), "valid")


def test_interval_of_a_change_covers_for_errors_correlated_over_the_horizon() -> None:
    covered: dict[str, list[bool]] = {"all": [], "x": [], "r": []}
    for seed in range(300):
        rng = np.random.default_rng(seed)
        t = 0.5 * np.arange(1200)
        pair: list[dict[str, PredictionErrors]] = [{}, {}]
        for name, ratio in (("x", 0.6), ("r", 1.5)):
            common = moving_average(rng, 1200, 20)
            for errors, factor in zip(pair, (1.0, ratio), strict=True):
                e = factor * (common + 0.5 * moving_average(rng, 1200, 20))
                errors[name] = PredictionErrors(t, e)
        found = prediction_change(*pair, horizon=10.0)
        covered["all"].append(found.low < (0.6 * 1.5) ** 0.5 < found.high)
        covered["x"].append(found.channels["x"].low < 0.6 < found.channels["x"].high)
        covered["r"].append(found.channels["r"].low < 1.5 < found.channels["r"].high)
    for name, inside in covered.items():
        assert 0.90 < np.mean(inside) < 0.98, name


def test_prediction_change_covers_all_channels() -> None:
    rng, t = np.random.default_rng(1), np.arange(0.0, 400.0, 0.5)
    old = {name: PredictionErrors(t, rng.normal(size=t.size)) for name in ("x", "y", "r")}
    new = {n: PredictionErrors(t, k * old[n].e) for n, k in (("x", 0.5), ("y", 0.5), ("r", 2.0))}
    found = prediction_change(old, new, 10.0)
    assert found.ratio == pytest.approx(0.5 ** (1 / 3))
    assert (found.verdict, found.named("fell"), found.named("rose")) == ("fell", ["x", "y"], ["r"])
    assert found.channels["r"].before == pytest.approx(old["r"].rms)
    assert found.channels["r"].after == pytest.approx(2 * old["r"].rms)
    same = prediction_change(old, old, 10.0)
    assert (same.ratio, same.low, same.high, same.verdict) == (1.0, 1.0, 1.0, "unchanged")
    # If the starts differ, the common times are compared. A channel that one model lacks is left out.
    later = {n: PredictionErrors(e.t[100:], e.e[100:]) for n, e in new.items() if n != "y"}
    shifted = prediction_change(old, later, 10.0)
    assert set(shifted.channels) == {"x", "r"}
    assert shifted.ratio == pytest.approx(1.0)


def test_records_are_compared_only_with_themselves() -> None:
    """A record that one model cannot evaluate does not change the comparison, nor does a channel that ends later."""
    t = 0.1 * np.arange(600)

    def errors(seed: int, scale: float) -> dict[str, PredictionErrors]:
        return {"x": PredictionErrors(t, scale * np.random.default_rng(seed).normal(size=t.size))}

    hard, easy = errors(1, 10.0), errors(2, 1.0)
    late = PredictionErrors(t + 2.0, easy["x"].e)
    for after in ({"hard": hard, "easy": easy}, {"easy": easy}, {"hard": {**hard, "late": late}, "easy": easy}):
        for before_errors, after_errors in (
            (after, {"easy": easy}),
            ({"easy": easy}, after),
            (after, {"hard": hard, "easy": easy}),
        ):
            found = prediction_change_by_record(before_errors, after_errors, 1.0)
            assert (found.ratio, found.verdict, set(found.channels)) == (1.0, "unchanged", {"x"})
    assert prediction_change_by_record({"a": easy, "b": hard}, {"b": errors(1, 5.0)}, 1.0).ratio == pytest.approx(0.5)
    assert np.isnan(prediction_change_by_record({"a": easy}, {"b": easy}, 1.0).ratio)


def test_no_verdict_without_an_interval_or_a_visible_change() -> None:
    t = np.arange(0.0, 60.0, 0.5)
    e = PredictionErrors(t, np.random.default_rng(1).normal(size=t.size))
    short = prediction_change({"x": e}, {"x": PredictionErrors(t, 0.1 * e.e)}, 10.0)
    assert short.ratio == pytest.approx(0.1)
    assert np.isnan(short.low)
    assert short.verdict == short.channels["x"].verdict == "unchanged"
    assert prediction_change({"x": e}, {"x": PredictionErrors(t, 0.999 * e.e)}, 1.0).verdict == "unchanged"
    assert prediction_change({"x": e}, {"x": PredictionErrors(t, 0.99 * e.e)}, 1.0).verdict == "fell"
    assert np.isnan(prediction_change({}, {}, 10.0).ratio)


def test_diverged_prediction_counts_as_an_error() -> None:
    t = np.arange(0.0, 400.0, 0.5)
    e = np.random.default_rng(1).normal(size=t.size)
    lost = np.where(t % 20.0 < 1.0, np.inf, 0.5 * e)
    assert np.isinf(PredictionErrors(t, lost).rms)
    found = prediction_change({"x": PredictionErrors(t, e)}, {"x": PredictionErrors(t, lost)}, 10.0)
    assert found.verdict == "rose"


def test_all_channels_are_predicted_for_any_sample_rows() -> None:
    """One sensor has samples on odd rows, another on every third. Each is predicted at its own samples, at most one row
    later than the horizon.
    """
    record = slide(1, 600)
    rows = np.arange(record.n_rows)
    odd = replace(record, y=np.column_stack([record.y[:, 0], np.where(rows % 2, 0.1, np.nan)]))
    run = Likelihood(MODEL).filter(odd, VALUES)
    found = horizon_errors(MODEL, odd, VALUES, run.x_filt, 10.0)
    assert (found["speed"].e.size, found["place"].e.size) == (250, 250)
    uneven = replace(odd, t=record.t + 0.03 * (rows % 3 == 1))
    later = horizon_errors(MODEL, uneven, VALUES, run.x_filt, 10.0)
    assert later["place"].e.size > 240
    late = later["place"].t - uneven.t[np.searchsorted(uneven.t, later["place"].t - 10.0 + 1e-6, "right") - 1]
    assert ((late >= 10.0 - 2e-6) & (late < 10.14)).all()


def test_interval_with_the_largest_errors_is_found() -> None:
    t = 0.1 * np.arange(1000)
    even, burst = np.ones(t.size), np.where((t >= 40.0) & (t < 60.0), 10.0, 1.0)
    errors = {name: PredictionErrors(t, e, np.ones(t.size)) for name, e in (("even", even), ("burst", burst))}
    found = largest_errors({"one": {"x": errors["even"]}, "two": {"x": errors["burst"]}}, 10.0)
    assert found is not None
    assert (found.record, found.begin, found.end) == ("two", 40.0, 60.0)
    assert found.share == pytest.approx(20000 / (1000 + 800 + 20000))
    # Each channel counts equally, whatever its unit is.
    both = {"x": errors["even"], "y": PredictionErrors(t, 1e6 * burst)}
    found = largest_errors({"one": both}, 10.0)
    assert found is not None
    assert found.share == pytest.approx((0.2 + 20000 / 20800) / 2)
    # The last interval ends with the record; errors of zero have no largest interval.
    late = largest_errors({"one": {"x": PredictionErrors(t[:950], np.where(t[:950] > 90.0, 5.0, 0.1))}}, 10.0)
    assert late is not None
    assert (late.begin, late.end) == (80.0, pytest.approx(94.9))
    assert largest_errors({"one": {"x": PredictionErrors(t, np.zeros(t.size))}}, 10.0) is None


def test_small_part_of_the_time_with_most_of_the_errors_is_found() -> None:
    t = 0.1 * np.arange(3000)
    ones = np.ones(t.size)
    burst = np.where((t >= 42.0) & (t < 48.0), 20.0, 1.0)
    errors = {"even": PredictionErrors(t, ones, ones), "burst": PredictionErrors(t, burst, ones)}
    found = concentrated_errors({"one": errors}, 10.0)
    assert found is not None
    assert found.spans == (("one", 40.0, 50.0),)
    assert found.shares == {"burst": pytest.approx((60 * 400 + 40) / (60 * 400 + 2940))}
    rest = without_spans({"one": errors, "two": errors}, found.spans)
    assert (rest["one"]["burst"].rms, rest["one"]["burst"].about.size, rest["two"]["burst"].e.size) == (1, 2900, 3000)
    # The same seconds of a short log are no small part, and events in many places are none either.
    short = {name: PredictionErrors(e.t[:900], e.e[:900]) for name, e in errors.items()}
    assert concentrated_errors({"one": short}, 10.0) is None
    events = PredictionErrors(t, np.where(t % 40.0 < 3.0, 20.0, 1.0))
    assert concentrated_errors({"one": {"burst": events}}, 10.0) is None
    assert concentrated_errors({"one": {"even": errors["even"]}}, 10.0) is None


def test_models_with_other_rows_predict_the_same_samples_of_equal_intervals() -> None:
    record, model = turning_record(3, 400), turning()
    run = Likelihood(model).filter(record, values_of(model))
    late = record.rows(slice(1, None))
    late_run = Likelihood(model).filter(late, values_of(model))
    step = float(np.median(np.diff(record.t)))
    both = [
        horizon_errors(model, r, values_of(model), x, 2.0, 2.0 * step)
        for r, x in ((record, run.x_filt), (late, late_run.x_filt))
    ]
    usual = [
        horizon_errors(model, r, values_of(model), x, 2.0) for r, x in ((record, run.x_filt), (late, late_run.x_filt))
    ]
    for name in both[0]:
        common = np.intersect1d(both[0][name].t, both[1][name].t).size
        assert common >= both[1][name].t.size - 1
    assert np.intersect1d(usual[0]["gyro"].t, usual[1]["gyro"].t).size < 0.7 * usual[1]["gyro"].t.size


def test_blocks_of_a_simulation_are_as_long_as_its_errors_are_correlated() -> None:
    rng, dt, t = np.random.default_rng(3), 0.1, 0.1 * np.arange(40_000)

    def first_order(tau: float) -> np.ndarray:
        """Return noise with the correlation time ``tau`` [s]."""
        e, a = rng.normal(size=t.size), np.exp(-dt / tau)
        for k in range(1, t.size):
            e[k] = a * e[k - 1] + np.sqrt(1 - a * a) * e[k]
        return e

    models = [
        {"run": {name: PredictionErrors(t, make()) for name, make in makers.items()}}
        for makers in (
            {"slow": lambda: first_order(20.0), "white": lambda: rng.normal(size=t.size), "x": lambda: 0 * t},
            {"slow": lambda: first_order(20.0), "white": lambda: rng.normal(size=t.size)},
        )
    ]
    found = correlated_blocks(*models)
    # the squares of first-order errors are correlated for half the time; a length is twice the correlation time
    assert found["slow"] == pytest.approx(4 * 20.0, rel=0.35)
    assert found["white"] < 1.0
    assert "x" not in found
    assert correlated_blocks(models[0], models[0]) == {"slow": 0.0, "white": 0.0, "x": 0.0}
