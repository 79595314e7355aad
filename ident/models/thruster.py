"""Thruster on the bench: command, shaft speed and force (thesis section 4.2, nominal values of its Table 2).

    n' = a (n_ref - n),   f = c1 n|n| + c2 n^2 + bias + b_f

n is the normalised shaft speed and f the force on the load cell. ``n_ref`` is the command, delayed by ``tau``. It is
zero inside the dead zone ``|n_cmd| < d``.

The record of a log contains copies of the command, delayed by multiples of a step (``delayed_channels``). The model
interpolates the copies at ``tau`` (``seatrial.ident.model.delayed_inputs``). The interpolation keeps the mean and
variance of the delay exact, and its derivative by ``tau`` is continuous. The delay needs no states, and a step of the
command stays a step in every copy.

``b_f`` is an Ornstein-Uhlenbeck force. It models the oscillation of the load cell, which is not white noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.data import Channel
from seatrial.ident.model import (
    DisturbanceChannel,
    Input,
    Model,
    ModelKind,
    Output,
    Parameter,
    ParameterRole,
    Sensor,
    Signals,
    StartGrid,
    State,
    Variable,
    built_in,
    delay_weights,
)
from seatrial.ident.models.dead_zone import outside_dead_zone
from seatrial.ident.models.disturbances import TIME, adder, shaft_disturbance
from seatrial.ident.models.published_values import TABLE_2

COMMAND = "n_cmd"
DELAY_STEP = 0.0125  # s, delay between copies of the command, unless the name of the model states another
START_DELAY_SPACING_S = 0.2  # s between the initial values of the delay
START_POLES = np.geomspace(0.2, 20.0, 14)  # 1/s, initial values of the pole
SLOW_STEP = 0.1  # s, step of ``thruster:slow``, with delays up to 4.8 s, for links that poll
N_DELAYS = 49  # number of copies of the command
DEAD_ZONE_EDGE = 0.005  # width of the transition at the end of the dead zone, in units of the command

SHAFT = (
    Parameter("a", TABLE_2["a"], "1/s", "pole of the shaft speed", "log"),
    Parameter("d", 0.0, "", "dead zone of the command", bounds=(0.0, 0.5), free=False, step=0.005),
    Parameter("s_n", 0.01, "1/sqrt(s)", "process noise of the shaft speed", "log"),
    Parameter("e_n", 0.005, "", "noise of the shaft speed", "log"),
)
FORCE = (
    Parameter("c1", TABLE_2["c1"], "N", "thrust at full speed, mean of ahead and astern", "log"),
    Parameter("c2", TABLE_2["c2"], "N", "thrust at full speed, half of ahead less astern", step=0.1),
    Parameter("bias", 0.0, "N", "offset of the load cell", per_record=True, step=0.1),
    Parameter("e_f", 0.5, "N", "noise of the load cell", "log"),
)
SWING = (
    Parameter("q_f", 0.5, "N/sqrt(s)", "diffusion of the disturbance force", "log", role=ParameterRole.DISTURBANCE),
    Parameter(
        "tau_f",
        0.5,
        "s",
        "correlation time of the disturbance force",
        "log",
        prior=(0.5, 0.5),
        bounds=(0.05, 20.0),
        role=ParameterRole.DISTURBANCE,
    ),
)


def _add_acceleration(s: Signals, extra: Any) -> None:
    """Add ``extra`` [1/s] to ``s.rate["n"]``, the time derivative of the normalised shaft speed."""
    s.rate["n"] = s.rate["n"] + extra


UNEXPLAINED_FORCE = DisturbanceChannel(
    "F", "N", "b_f", 5.0, "the force on the load cell", adder("force"), "thrust", place="bench", requires=("bench",)
)
UNEXPLAINED_RATE = DisturbanceChannel(
    "n_dot",
    "1/s",
    "b_n",
    0.5,
    "the acceleration of the shaft",
    _add_acceleration,
    "rate",
    place="bench",
    requires=("bench",),
)


def delayed_channels(
    channel: Channel, step: float = DELAY_STEP, n: int = N_DELAYS, name: str = COMMAND
) -> dict[str, Channel]:
    """Return copies of a command, ``NAME_0`` to ``NAME_<n-1>``, each delayed by ``step`` more than the one before.

    Parameters
    ----------
    channel : Channel
        The command, with at least one sample.
    step : float
        Delay between copies [s].
    n : int
        Number of copies. The first copy has no delay.
    name : str
        Prefix of the names.

    Returns
    -------
    dict
        The copies by name. Each copy also has the first value of the command at the time of its first sample, so that
        it is constant until the delay has passed.

    Notes
    -----
    Steps of the command stay steps. `seatrial.ident.model.delayed_inputs` compares these copies with those of other
    models.
    """
    copies = {}
    for k in range(n):
        t = np.append(channel.t[:1], channel.t + k * step)
        copies[f"{name}_{k}"] = Channel(t, np.append(channel.value[:1], channel.value), channel.unit, channel.source)
    return copies


def delay_step(model: Model) -> float:
    """Return the delay [s] between successive copies of the command in a thruster model.

    The delay is the upper bound of the parameter ``tau``, divided by the number of copies less one.
    """
    return model.parameter("tau").bounds[1] / (sum(i.tap_of == COMMAND for i in model.inputs) - 1)


def pace_with_copy_at(tau: float, step: float) -> str:
    """Return the ``pace`` of a thruster model in which one of the copies of the command has exactly the delay ``tau``.

    Parameters
    ----------
    tau : float
        Delay [s].
    step : float
        Desired delay between copies [s].

    Returns
    -------
    str
        Delay between copies [s] as text, near ``step``, of which ``tau`` is a multiple (with six digits). It is the
        option ``pace`` of `thruster_model`. Empty if ``tau`` is at most half of ``step``, so that the model uses its
        own step.

    Notes
    -----
    If ``tau`` lies between two copies, a step of the command arrives in two parts, one too early and one too late. This
    looks like a lag of the shaft. If ``tau`` is the delay of a copy, the step is exact.
    """
    k = round(tau / step)
    return f"{tau / k:.6g}" if k > 0 else ""


def thruster_model(
    pace: str = "", *, force: bool = True, swing: bool = True, step: float = DELAY_STEP, n_delays: int = N_DELAYS
) -> Model:
    """Return the model of a thruster on the bench: delay, dead zone, first-order shaft lag, and static thrust.

    Parameters
    ----------
    pace : str
        Delay [s] between copies of the command as text (``pace_with_copy_at``), above zero, or ``slow`` for 0.1 s,
        which allows delays up to 4.8 s. Empty: ``step`` is used. Otherwise ``step`` is ignored.
    force : bool
        Whether the bench has a load cell. Without one, the model has no thrust coefficients and no output ``force``.
    swing : bool
        Whether the model has the disturbance force ``b_f`` of the load cell. It is ignored without a load cell.
    step : float
        Delay between copies of the command [s].
    n_delays : int
        Number of copies, including the one without delay. The largest delay is ``(n_delays - 1)`` times the delay
        between copies.

    Returns
    -------
    Model
        Model with the inputs ``n_cmd_0``, ``n_cmd_1``, ... (copies of the command, -1 to 1), and the outputs ``n``
        (normalised shaft speed) and, with a load cell, ``force`` [N]. It has additional initial values of delay and
        pole if the copies are more than 0.025 s apart.

    Raises
    ------
    ValueError
        If ``pace`` is neither empty, ``slow`` nor a number.
    """
    step = SLOW_STEP if pace == "slow" else float(pace or step)
    top = step * (n_delays - 1)
    delay = Parameter("tau", min(0.1, top / 2), "s", "delay of the command", bounds=(0.0, top), step=0.005)
    states, sensors, parameters = _components(force, force and swing)

    def reference(s: Signals) -> Any:
        """Return the delayed command, -1 to 1, by interpolation of its copies at ``tau``.

        Before the interpolation, each copy is set to zero inside the dead zone.
        """
        weights = enumerate(delay_weights(s.p.tau / step, n_delays))
        # Two to four weights of a numerical delay are not zero; weights of a symbolic delay are never skipped
        return sum(
            w * outside_dead_zone(getattr(s.u, f"{COMMAND}_{k}"), s.p.d, DEAD_ZONE_EDGE)
            for k, w in weights
            if not (isinstance(w, float) and w == 0.0)
        )

    def shaft(s: Signals) -> None:
        """Set ``s.n_ref`` and ``s.n``, the normalised shaft speed, which is a state.

        ``s.n_ref`` is the delayed command; it is zero inside the dead zone.
        """
        s.n_ref, s.n = reference(s), s.x.n

    return Model(
        "thruster",
        states,
        tuple(
            Input(f"{COMMAND}_{k}", label="" if k else COMMAND, tap_of=COMMAND, delay=k * step, prefilter=False)
            for k in range(n_delays)
        ),
        sensors,
        built_in((delay, *parameters)),
        (("shaft", shaft), ("thrust", _set_thrust), ("rate", _set_rates), ("output", _set_outputs)),
        provides=("bench", "thrust") if force else ("bench",),
        source=f"thruster:{pace}" if pace else "thruster",
        residuals=(UNEXPLAINED_FORCE, UNEXPLAINED_RATE) if force and swing else (UNEXPLAINED_RATE,),
        variables=(
            Variable("n", "", lambda s: s.x.n),
            Variable("n_ref", "", reference),
            Variable("slip", "", lambda s: reference(s) - s.x.n),
            TIME,
        ),
        block=2.0,
        kind=ModelKind.BENCH,
        horizon=1.0,
        disturbance=shaft_disturbance(),
        start_grid=_start_grid(top) if step > 2 * DELAY_STEP else None,
    )


def _start_grid(longest: float) -> StartGrid:
    """Return the initial values with which the search for the delay ``tau`` [s] and the pole ``a`` [1/s] is repeated.

    The delays run from 0 to below ``longest`` [s] in steps of 0.2 s, and are combined with each pole of `START_POLES`
    (14 values, 0.2 to 20). They are needed because the likelihood has several maxima with low-rate telemetry.
    """
    delays = np.arange(0.0, longest, START_DELAY_SPACING_S)
    return StartGrid(("tau", "a"), (tuple(delays.tolist()), tuple(START_POLES.tolist())), START_DELAY_SPACING_S)


def _components(force: bool, swing: bool) -> tuple[tuple[State, ...], tuple[Sensor, ...], tuple[Parameter, ...]]:
    """Return the states, sensors and parameters of a thruster model, without the parameter of the delay.

    ``force``: the bench has a load cell. ``swing``: the load cell has the disturbance force ``b_f`` as a state.
    """
    states = [State("n", "", "shaft speed, normalised", "s_n", from_output="n", sd0=0.1)]
    sensors, parameters = [Sensor("rpm", (Output("n", "", "e_n"),))], [*SHAFT]
    if force:
        sensors.append(Sensor("load_cell", (Output("force", "N", "e_f"),)))
        parameters += FORCE
    if swing:
        states.append(State("b_f", "N", "disturbance force", "q_f", sd0=1.0, nuisance=True))
        parameters += SWING
    return tuple(states), tuple(sensors), tuple(parameters)


def _set_thrust(s: Signals) -> None:
    """Set the thrust ``s.force = c1 n|n| + c2 n^2`` [N] at the normalised shaft speed ``s.n``.

    In a model without a load cell, which lacks the parameter ``c1``, ``s.force`` is not set.
    """
    if hasattr(s.p, "c1"):
        s.force = s.p.c1 * s.n * abs(s.n) + s.p.c2 * s.n * s.n


def _set_rates(s: Signals) -> None:
    """Set the derivatives ``s.rate``: n' = a (n_ref - n) [1/s], and b_f' = -b_f / tau_f [N/s] if b_f is a state."""
    s.rate["n"] = s.p.a * (s.n_ref - s.x.n)
    if hasattr(s.x, "b_f"):
        s.rate["b_f"] = -s.x.b_f / s.p.tau_f


def _set_outputs(s: Signals) -> None:
    """Set the outputs ``s.y``: shaft speed ``n``, and the ``force`` [N] if the model has a load cell.

    The output ``force`` is the thrust plus the offset of the load cell and, if it is a state, the disturbance force.
    """
    s.y["n"] = s.x.n
    if hasattr(s, "force"):
        s.y["force"] = s.force + s.p.bias + getattr(s.x, "b_f", 0.0)
