"""Tests of blocked cross-validation: each block is predicted with estimates from the other blocks, without a second
fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import Record
from seatrial.ident.estimation.cross_validation import (
    FEWEST_BLOCKS,
    MOST_BLOCKS,
    TimeBlocks,
    leave_one_block_out,
    time_blocks,
)
from seatrial.ident.estimation.fitted_model import (
    cut_into_blocks,
    evaluate_records,
    fit_and_evaluate,
    times_of_change,
    validated_in_blocks,
)
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import fit
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import PARAMETERS, Effect, EffectKind, Input, Signals, State
from tests.ident.estimation.test_homogeneity import pushed, records

MODEL = replace(pushed(), block=0.4)  # Blocks of 0.4 s. A record of 30 s has at least five blocks.


@pytest.fixture(scope="module")
def data() -> list[Record]:
    return records((40.0, 40.0), 3)


def split(data: list[Record], block: float = MODEL.block) -> TimeBlocks:
    return time_blocks(data, block, [{"u": (0.5, 0.5)}] * len(data))


def test_blocks_cover_each_record_exactly_once(data: list[Record]) -> None:
    blocks = split(data)
    assert blocks.record_indices == (*[0] * 6, *[1] * 6)
    for i, record in enumerate(data):
        t = np.concatenate([b.t for b, of in zip(blocks.records, blocks.record_indices, strict=True) if of == i])
        np.testing.assert_array_equal(t, record.t)
    assert len({b.name for b in blocks.records}) == 12
    assert len(split(data, 1e-3).record_indices) == 2 * MOST_BLOCKS
    assert len(split(data, 1e3).record_indices) == 2 * FEWEST_BLOCKS


def test_newton_step_equals_a_fit_to_the_other_blocks(data: list[Record]) -> None:
    blocks, fitted = split(data), fit(MODEL, data)
    found = leave_one_block_out(fitted.model, blocks, fitted.record_values, fitted.parameters)
    names = list(MODEL.values)
    moved = []
    for k in range(len(blocks.record_indices)):
        others = fit(MODEL, [b for j, b in enumerate(blocks.records) if j != k])
        for name in ("m", "d", "e"):
            error = fitted.errors[fitted.names.index(name)]
            assert abs(found[k][names.index(name)] - others.estimate(name)[0]) < 0.15 * error, (k, name)
            moved.append(abs(others.estimate(name)[0] - fitted.estimate(name)[0]) / error)
    assert max(moved) > 0.5  # The estimates do differ between the blocks.


def drifting() -> Effect:
    """Return a push with a per-record size, in addition to the known push."""

    def add(s) -> None:
        s.u.X = s.u.X + s.p.extra

    own = Parameter("extra", 0.0, "N", prior=(0.0, 5.0), per_record=True, step=0.1)
    return Effect("extra-push", "a push", {PARAMETERS: add}, (own,))


def test_per_record_parameters_of_an_effect_come_from_the_other_blocks(data: list[Record]) -> None:
    """They are not adapted to the predicted block. Per-record parameters of the nominal model are adapted to it."""
    for kind, held_out in ((EffectKind.CATALOGUE, True), (EffectKind.DISTURBANCE, False)):
        model = MODEL + replace(drifting(), kind=kind)
        fitted = fit_and_evaluate(model, data, data[1:])
        blocks = validated_in_blocks(fitted).validation
        at = list(model.values).index("extra")
        for view in blocks:
            likelihood = Likelihood(fitted.fit.model)
            score = likelihood.scores(view.record, view.values, ["extra"])
            z = float(score.gradient[0] / np.sqrt(score.information[0, 0]))
            if held_out:
                assert abs(view.values[at] - fitted.validation[0].values[at]) < 1.0
            else:
                prior = view.values[at] / 25.0 / np.sqrt(score.information[0, 0])
                assert abs(z - prior) < 0.1  # The value is at the maximum of the posterior.
        assert len({round(float(v.values[at]), 9) for v in blocks}) == len(blocks)


def charging() -> Effect:
    """Return a push that builds up for longer than a block. Its state is at rest only at the start of the record."""

    def rate(s: Signals) -> None:
        s.rate["z"] = (1.0 - s.x.z) / 3.0
        s.rate["u"] = s.rate["u"] + s.p.k_charge * s.x.z

    k = Parameter("k_charge", 0.1, "m/s^2", step=0.01)
    return Effect("charging", "a push that builds up", {"rate": rate}, (k,), (State("z", sd0=1e-6),))


def test_block_starts_from_the_states_of_an_effect_in_the_whole_record(data: list[Record]) -> None:
    plain = fit_and_evaluate(MODEL, data, [])
    blocks = cut_into_blocks(data, plain.estimation, MODEL.block)
    fitted = fit_and_evaluate(MODEL + charging(), data, blocks)
    assert all("z" not in r.start for r in blocks.records)
    for view, of in zip(fitted.validation, blocks.record_indices, strict=True):
        states = [s.name for s in view.model.states]
        mean, sd = view.record.start["z"]
        assert mean == pytest.approx(fitted.estimation[of].run.x_filt[:, states.index("z")].mean())
        assert view.run.x_pred[0, states.index("z")] == pytest.approx(mean)
        assert 0.5 < mean < 1.0
        assert sd > 0.1
        assert view.record.start["u"] == blocks.records[0 if of == 0 else blocks.record_indices.index(of)].start["u"]


def test_failed_validation_run_is_listed_and_the_others_are_kept(data: list[Record]) -> None:
    wild = replace(data[1], name="wild", u=np.full_like(data[1].u, 1e200), u_next=np.full_like(data[1].u, 1e200))
    for model in (MODEL, MODEL + replace(drifting(), kind=EffectKind.DISTURBANCE)):
        fitted = fit_and_evaluate(model, data[:1], [data[1], wild])
        assert [v.record.name for v in fitted.validation] == ["run1"]
        assert [f.record for f in fitted.failed] == ["wild"]
        assert "likelihood" in fitted.failed[0].reason


def tugged() -> Effect:
    """Return a force that begins at a time of its own in each record."""

    def add(s: Signals) -> None:
        s.u.X = s.u.X + s.p.tug * (1 + np.tanh((s.u.t - s.p.t_tug) / 0.5)) / 2

    own = (
        Parameter("tug", 0.0, "N", prior=(0.0, 5.0), per_record=True, step=0.1),
        Parameter("t_tug", 8.0, "s", prior=(15.0, 15.0), per_record=True, step=0.5),
    )
    return Effect("tug", "a pull that begins", {PARAMETERS: add}, own, inputs=(Input("t", "s", "linear"),),
                  scan={"t_tug": (5.0, 15.0, 25.0)})  # fmt: skip


def test_time_of_a_change_is_found_in_each_record_that_was_not_fitted(data: list[Record]) -> None:
    model = MODEL + tugged()
    times, made = (7.0, 22.0), []
    for record, at in zip(data, times, strict=True):
        late = np.cumsum(np.where(record.t > at, -4.0 * 0.1 / 40.0, 0.0) * np.exp(-(record.t - at).clip(0) * 0.2))
        u = np.column_stack([record.u, record.t])
        made.append(replace(record, u=u, u_next=u, inputs=("X", "t"), y=record.y + late[:, None]))
    views, failed = evaluate_records(model.with_values({"tug": -4.0}), made)
    assert not failed
    found = [view.values[list(model.values).index("t_tug")] for view in views]
    assert found == pytest.approx(times, abs=1.5)
    assert [view.values[list(model.values).index("tug")] for view in views] == pytest.approx([-4.0, -4.0], abs=1.2)


def test_times_of_change_cover_the_longest_record_in_steps(data: list[Record]) -> None:
    sets = times_of_change([tugged(), drifting()], data)
    assert sets == [{"t_tug@0": at, "t_tug@1": at} for at in (10.0, 20.0)]
    assert times_of_change([drifting()], data) == []
