"""Oracle of the recovery study: the model with the true structure, and the true curve of an effect outside the
catalogue.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data.record import LogSegment, make_record
from seatrial.ident.diagnosis.common_errors import COMMON_ERRORS, COMMON_SEARCH
from seatrial.ident.effects.registry import catalogue
from seatrial.ident.estimation.fitted_model import (
    FittedModel,
    fit_and_evaluate,
    nominal_model,
    with_all_candidates,
    without_absent_sensors,
)
from seatrial.ident.model.structure import Effect
from seatrial.ident.results.parts import NonparametricCurve
from seatrial.mocks.hidden_effects.catalogue import make_effect
from tests.recovery.kinds import Case, boat_of, model_of

Array = NDArray[np.float64]
RATE = 10.0  # Unit: Hz


def oracle(case: Case, runs: Sequence[LogSegment]) -> FittedModel | None:
    """Fit the effects of the catalogue with the true names. Return None if the catalogue lacks one of them."""
    known = catalogue()
    if any(name not in known for name in case.truths):
        return None
    effects = {name: _near_the_truth(known[name], case) for name in case.truths}
    base = nominal_model(model_of(case))
    everything, kept = with_all_candidates(base, effects, runs)
    records = [make_record(everything, r, RATE) for r in runs]
    model = without_absent_sensors(base, records)
    for effect in kept.values():
        model = model + effect
    return fit_and_evaluate(model, records[:1], records[1:])


def dominance(case: Case, runs: Sequence[LogSegment]) -> tuple[FittedModel, FittedModel] | None:
    """Fit the small errors of sensors and hull form without the true effect, and with it.

    Return None for a boat without an effect, and if the catalogue lacks the true effect.
    """
    known = catalogue()
    if not case.truths or any(name not in known for name in case.truths):
        return None
    base = nominal_model(model_of(case))
    small = {n: known[n] for n in COMMON_ERRORS if n in known and n not in case.truths and base.accepts(known[n])}
    large = {name: _near_the_truth(known[name], case) for name in case.truths}
    everything, kept = with_all_candidates(base, small | large, runs)
    records = [make_record(everything, r, RATE) for r in runs]
    model = without_absent_sensors(base, records)
    for name in kept.keys() - set(case.truths):
        model = model + kept[name]
    full = model
    for name in case.truths:
        full = full + kept[name]
    without, fitted = (fit_and_evaluate(m, records[:1], records[1:], settings=COMMON_SEARCH) for m in (model, full))
    return without, fitted


def _near_the_truth(effect: Effect, case: Case) -> Effect:
    """Start near the truth if a size of zero has no gradient or a frequency has several optima. The oracle may use the
    truth.
    """
    true = make_effect(effect.name, case.seed, case.how.scale).parameters
    known = {
        "f_p": true.get("frequency_hz"),
        "f_wave": true.get("frequency_hz"),
        "A_X": true.get("surge"),
        "A_Y": true.get("sway"),
        "A_N": true.get("yaw"),
    }
    start = [p.at(value) if (value := known.get(p.name)) is not None else p for p in effect.parameters]
    return replace(effect, parameters=tuple(start))


def shape_share(case: Case, shapes: Sequence[NonparametricCurve]) -> float | None:
    """Return the share of the drawn curve whose band contains the true curve. Return None without a suitable drawn
    curve.

    Parts that the model's own parameters can absorb are not compared: a constant, the drag for X(u), and the thrust for
    X(n_sum).
    """
    answer = next((e.answer for e in boat_of(case).effects if e.answer is not None), None)
    if answer is None:
        return None
    drawn = next((s for s in shapes if (s.force, s.variable) == (answer.force, answer.variable)), None)
    if drawn is None:
        return None
    true = np.array([answer.curve(float(z)) for z in drawn.grid])
    apart = _beyond(drawn, drawn.value - true)
    return float(np.mean(np.abs(apart) < drawn.band))


def _beyond(drawn: NonparametricCurve, difference: Array) -> Array:
    """Return the difference of two curves without the part that damping or thrusters of the model can absorb."""
    z = drawn.grid
    columns = [np.ones(z.size)]
    if (drawn.force, drawn.variable) in {("X", "u"), ("Y", "v"), ("N", "r"), ("X", "n_sum"), ("N", "n_diff")}:
        columns += [z, z * np.abs(z)]
    basis = np.column_stack(columns)
    return np.asarray(difference - basis @ np.linalg.lstsq(basis, difference, rcond=None)[0])
