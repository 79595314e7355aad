"""Evaluation of a model with one more effect that repeats only what the effect changes.

The diagnosis evaluates a hundred candidates along the same trajectory. The signals before the place at which a
candidate first changes something are the same for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from seatrial.ident.model.structure import PARAMETERS, Model, Named, Signals
from seatrial.ident.numerics import Array

Values = Mapping[str, Any]


@dataclass(frozen=True)
class _Run:
    """Recorded evaluation of a model.

    Attributes
    ----------
    start
        Signals before the first stage.
    after
        Signals after each place, in the order of the places; at least one place.
    """

    start: Signals
    after: Sequence[Signals]

    def agrees(self, s: Signals, parts: str = "xup") -> bool:
        """Return whether the states, inputs and parameters in ``s`` have the values before the first recorded stage.

        They may have further values. ``parts`` are those of the three that are compared.
        """
        for part in parts:
            given = vars(getattr(s, part))
            for name, value in vars(getattr(self.start, part)).items():
                other = given.get(name)
                if value is not other and not np.array_equal(value, other):
                    return False
        return True

    def continued(self, place: int, start: Signals) -> Signals:
        """Return new signals after the place with the index ``place``, or after the last recorded place.

        ``start`` are the signals of a larger model before its first stage. Its further states, inputs and parameters
        are among the result.
        """
        s = _copy(self.after[min(place, len(self.after) - 1)])
        for part in "xup":
            larger = vars(getattr(start, part))
            setattr(s, part, type(getattr(start, part))(**(larger | vars(getattr(s, part)))))
        return s


class RecordedEvaluation:
    """Signals of a model at each place, from which the evaluation of the model with one more effect continues.

    A place is a stage or one of its ``LATER`` places.

    Parameters
    ----------
    model : Model
        The model.
    x, u, p : Sequence
        Columns (n_rows,) of the states and inputs, and numbers for the parameters, in the order of the model. The
        columns become read-only.

    Raises
    ------
    ValueError
        If the number of values is wrong, or if a function of the model changes an array in place.
    TypeError
        If a function of the model does not accept arrays.
    """

    def __init__(self, model: Model, x: Sequence[Array], u: Sequence[Array], p: Sequence[float]) -> None:
        self._model = model
        self._repeated: list[_Run] = []  # evaluations by `Signals.again`
        self._computed: dict[str, Any] = {}  # results of `Signals.once`
        s = model.initial_signals(x, u, p)

        def again(x: Values, u: Values, p: Values) -> Signals:
            """Run the model again up to the time derivatives (`Signals.again`), and record it."""
            changed = s.with_values(x, u, p)
            self._repeated.append(self._record(changed, until_output=True))
            return changed

        def once(name: str, compute: Callable[[], Any]) -> Any:
            """Return ``compute()``, and store the result (`Signals.once`)."""
            self._computed[name] = compute()
            return self._computed[name]

        s.again, s.once = again, once
        self._run = self._record(s)

    def signals(
        self, larger: Model, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any], *, until_output: bool = False
    ) -> Signals:
        """Evaluate ``larger``, which is the recorded model with one more effect.

        Parameters
        ----------
        larger : Model
            ``model + effect``.
        x, u, p : Sequence
            Values of its states, inputs and parameters, in its order. For those of the recorded model, the values must
            be the recorded ones.
        until_output : bool
            Whether the outputs are not needed.

        Returns
        -------
        Signals
            Those of `Model.signals`. With ``until_output``, some outputs may be missing.

        Raises
        ------
        ValueError
            If ``larger`` is another model, or if the number of values is wrong. Also if a function changes a recorded
            array in place.
        """
        if larger.effects[:-1] != self._model.effects or larger.stages != self._model.stages:
            raise ValueError(f"model {larger.name} is not the recorded model {self._model.name} with one more effect")
        start, hooks = larger.initial_signals(x, u, p), larger.effects[-1].hooks
        if PARAMETERS in hooks:  # every signal may differ
            larger.run_stages(start, until_output=until_output)
            return start
        places = larger.places
        first = min((places.index(place) for place in hooks if place in places), default=len(places) - 1)
        s = self._run.continued(first, start)

        def again(x: Values, u: Values, p: Values) -> Signals:
            """Run the larger model again up to the time derivatives (`Signals.again`)."""
            changed, continued_at = s.with_values(x, u, p), None
            for run in self._repeated:
                if run.agrees(changed):
                    changed, continued_at = run.continued(first, changed), first
                    break
            larger.run_stages(changed, until_output=True, continued_at=continued_at)
            return changed

        def once(name: str, compute: Callable[[], Any]) -> Any:
            """Return the recorded result if inputs and parameters are the same, or ``compute()`` (`Signals.once`)."""
            return self._computed[name] if name in self._computed and self._run.agrees(s, "up") else compute()

        s.again, s.once = again, once
        larger.run_stages(s, until_output=until_output, continued_at=first)
        return s

    def _record(self, s: Signals, *, until_output: bool = False) -> _Run:
        """Run the model on the signals ``s``, which are changed in place, and return copies of them after each place.

        With ``until_output``, the stage ``output`` does not run.
        """
        start, after = _protected_copy(s), list[Signals]()
        self._model.run_stages(s, until_output=until_output, after_each=lambda: after.append(_protected_copy(s)))
        return _Run(start, after)


def _copy(s: Signals) -> Signals:
    """Return a copy of signals that contains the same arrays, without `Signals.again` and `Signals.once`."""
    copied = Signals()
    for name, value in vars(s).items():
        if isinstance(value, Named):
            value = type(value)(**vars(value))
        elif isinstance(value, (dict, list)):
            value = value.copy()
        if name not in ("again", "once"):
            setattr(copied, name, value)
    return copied


def _protected_copy(s: Signals) -> Signals:
    """Return a copy of signals, as `_copy`, and make all arrays among them read-only."""
    copied = _copy(s)
    for value in vars(copied).values():
        if isinstance(value, Named):
            value = vars(value)
        _protect(value.values() if isinstance(value, dict) else value if isinstance(value, list) else [value])
    return copied


def _protect(values: Iterable[Any]) -> None:
    """Make the arrays among some values read-only."""
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
