"""Past of the inputs of an exported model: the physical inputs, and the delay of each input of the equations.

The equations of a model with a delay have many inputs, for example the 17 values of a command from now to 0.8 s ago. A
controller has one value for each thruster. The exported files therefore keep the past of the physical inputs and
compute the inputs of the equations from it, as `seatrial.ident.data.record.build_record` computes them from a log.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from seatrial.ident.data import COMMANDS, SHAFTS, TIME_INPUT, WORK_INPUT
from seatrial.ident.model import Input, Model

TIME, WORK = -1, -2  # in `History.sources`: the time since the start, and the work of the thrusters


@dataclass(frozen=True)
class History:
    """Relation between the physical inputs of a model and the inputs of its equations.

    Attributes
    ----------
    inputs : tuple of Input
        Physical inputs: one for each signal that a user of the model provides. The input ``t`` is not among them. The
        input ``work`` is among them only if the model has no thruster from which it can be computed.
    sources : tuple of int
        Index in ``inputs`` for each input of the model; `TIME` (-1) or `WORK` (-2) for an input that is computed.
    delays : tuple of float
        Delay of each input of the model behind its source [s]; negative for a later value.
    shafts : tuple of int
        Indices in ``inputs`` of the two shaft speeds or commands from which ``work`` is computed. Empty: ``work`` is
        not computed.
    max_step : float
        Longest step of the integration [s]. Longer steps are divided.
    """

    inputs: tuple[Input, ...]
    sources: tuple[int, ...]
    delays: tuple[float, ...]
    shafts: tuple[int, ...]
    max_step: float

    @property
    def linear(self) -> tuple[bool, ...]:
        """Whether each physical input is interpolated linearly between its samples. False: each sample is held."""
        return tuple(i.hold == "linear" for i in self.inputs)

    @property
    def longest(self) -> tuple[float, ...]:
        """Longest delay of each physical input [s]; zero if no copy of the input has a positive delay."""
        pairs = list(zip(self.sources, self.delays, strict=True))
        return tuple(max([0.0, *(d for s, d in pairs if s == k)]) for k in range(len(self.inputs)))


def delayed_inputs(inputs: Iterable[Input]) -> list[str]:
    """Return the names of the signals of which the inputs have a copy of earlier values, each once."""
    return list(dict.fromkeys(i.tap_of for i in inputs if i.tap_of and i.delay > 0.0))


def history_of(model: Model) -> History:
    """Return the physical inputs of a model, and the source and the delay of each of its inputs.

    The physical inputs are in the order in which the model's inputs first need them. A delayed copy whose original is
    no input of the model gives a physical input with the name of the original. ``work`` is computed from two shaft
    speeds if both are inputs, else from two commands; without these it is a physical input.

    Notes
    -----
    A copy with the hold ``zero`` (`seatrial.ident.models.thruster`) has a row for each of its changes in a record. The
    steps of the export are therefore not longer than the shortest positive delay of such a copy.
    """
    own = {i.name: i for i in model.inputs if not i.tap_of}
    physical: dict[str, Input] = {}
    for i in model.inputs:
        name = i.tap_of or i.name
        if name not in physical and name != TIME_INPUT:
            physical[name] = own.get(name) or Input(name, i.unit, i.hold, i.angle, prefilter=i.prefilter)
    shafts: tuple[str, ...] = ()
    if WORK_INPUT in physical:
        shafts = next((pair for pair in (SHAFTS, COMMANDS) if set(pair) <= set(physical)), ())
    if shafts:
        del physical[WORK_INPUT]
    names = list(physical)
    computed = {TIME_INPUT: TIME} | ({WORK_INPUT: WORK} if shafts else {})
    stepped = [i.delay for i in model.inputs if i.tap_of and not i.tap and i.hold == "zero" and i.delay > 0.0]
    return History(
        tuple(physical.values()),
        tuple(computed[n] if n in computed else names.index(n) for n in (i.tap_of or i.name for i in model.inputs)),
        tuple(i.delay for i in model.inputs),
        tuple(names.index(n) for n in shafts),
        min([model.max_step, *stepped]),
    )
