"""Tests of multistart on a shaft speed that is reported every two seconds.

A long delay with a fast shaft and a short delay with a slow shaft then fit almost equally well.
"""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.data.record import Channel, Record, build_record
from seatrial.ident.estimation.maximum_likelihood import Fit, fit
from seatrial.ident.estimation.multistart import alternative_starts, best_of_starts
from seatrial.ident.models.thruster import delay_step, delayed_channels, thruster_model

pytestmark = pytest.mark.usefixtures("quick_compilation")

TAU, POLE = 0.3, 2.2


def polled(seed: int) -> Record:
    """Return a record with steps about every eight seconds and reports every two to three seconds, the first soon after
    a step.
    """
    rng = np.random.default_rng(seed)
    t_cmd = np.cumsum(rng.uniform(6.0, 10.0, 60))
    level = rng.uniform(-0.7, 0.7, 60)
    t = np.sort(np.concatenate([np.cumsum(rng.uniform(2.0, 3.0, 190)), t_cmd + rng.uniform(0.9, 1.6, 60)]))
    n, shaft, last = np.zeros(t.size), 0.0, 0.0
    switches = np.concatenate([t_cmd + TAU, [1e9]])
    k, commanded = 0, 0.0
    for i, now in enumerate(t):
        while switches[k] < now:
            shaft = commanded + (shaft - commanded) * np.exp(-POLE * (switches[k] - last))
            last, commanded, k = switches[k], level[k], k + 1
        shaft = commanded + (shaft - commanded) * np.exp(-POLE * (now - last))
        last, n[i] = now, shaft
    model = thruster_model("slow", force=False)
    channels = delayed_channels(Channel(np.append(0.0, t_cmd), np.append(0.0, level)), delay_step(model))
    channels["n"] = Channel(t, n + 0.004 * rng.standard_normal(t.size))
    return build_record(model, channels, rate=20.0)


def test_highest_maximum_is_found_from_a_lower_one() -> None:
    model, record = thruster_model("slow", force=False), polled(1)

    def refit(start: dict[str, float]) -> Fit:
        return fit(model, [record], start=start)

    lower = refit({"tau": 1.1, "a": 20.0})
    assert lower.model.values["tau"] > 0.6
    best = best_of_starts(lower, [record], refit)
    assert best.log_posterior > lower.log_posterior + 20.0
    assert best.model.values["tau"] == pytest.approx(TAU, abs=0.1)
    assert best.model.values["a"] == pytest.approx(POLE, rel=0.15)


def test_starts_differ_from_the_fit_and_from_each_other() -> None:
    model, record = thruster_model("slow", force=False), polled(2)
    top = fit(model, [record], start={"tau": TAU, "a": POLE})
    delays = [top.model.values["tau"], *[s["tau"] for s in alternative_starts(top, [record])]]
    assert len(delays) == 3
    assert np.diff(np.sort(delays)).min() > 0.25


def test_a_fixed_parameter_keeps_its_value() -> None:
    model, record = thruster_model("slow", force=False), polled(2)
    free = [p.name for p in model.parameters if p.free]
    for fixed in ("tau", "a"):
        held = model.with_values({"tau": 0.9, "a": 4.0}).with_free([n for n in free if n != fixed])
        first = fit(held, [record])
        starts = alternative_starts(first, [record])
        assert all(s[fixed] == held.values[fixed] for s in starts)
        assert bool(starts) is (fixed == "a")
        best = best_of_starts(first, [record], lambda start, held=held: fit(held, [record], start=start))
        assert best.model.values[fixed] == held.values[fixed]


def test_only_models_of_polled_links_have_several_starts() -> None:
    assert thruster_model("slow").start_grid is not None
    assert thruster_model("0.11").start_grid is not None
    assert thruster_model().start_grid is None
