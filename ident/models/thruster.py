"""Thruster on the bench: command, shaft speed and force (thesis section 4.2, nominal values of its Table 2).

    n' = a (n_ref - n),   f = c1 n|n| + c2 n^2 + bias + b_f

``n_ref`` is the command, delayed by ``tau``. It is zero inside the dead zone ``|n_cmd| < d``.

The data set contains copies of the command with delays of multiples of a step (``delayed_channels``). The model mixes
the two or four copies next to ``tau`` by cubic convolution (Keys 1981). The convolution keeps the mean and variance of
the delay exact, and its derivative by ``tau`` is continuous. No states are needed, and a step of the command stays a
step in every copy.

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
)
from seatrial.ident.models.disturbances import TIME, adder, shaft_disturbance
from seatrial.ident.models.published_values import TABLE_2

COMMAND = "n_cmd"
DELAY_STEP = 0.0125  # s
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
    Parameter("c1", TABLE_2["c1"], "N", "thrust at full speed, odd part", "log"),
    Parameter("c2", TABLE_2["c2"], "N", "thrust at full speed, even part", step=0.1),
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


def _accelerate(s: Signals, extra: Any) -> None:
    s.rate["n"] = s.rate["n"] + extra


UNEXPLAINED_FORCE = DisturbanceChannel(
    "F", "N", "b_f", 5.0, "the force on the load cell", adder("force"), "thrust", place="bench", requires=("bench",)
)
UNEXPLAINED_RATE = DisturbanceChannel(
    "n_dot", "1/s", "b_n", 0.5, "the acceleration of the shaft", _accelerate, "rate", place="bench", requires=("bench",)
)


def delayed_channels(
    channel: Channel, step: float = DELAY_STEP, n: int = N_DELAYS, name: str = COMMAND
) -> dict[str, Channel]:
    """Return copies of a command, ``NAME_0`` to ``NAME_<n-1>``, each delayed by ``step`` more than the one before.

    Parameters
    ----------
    channel : Channel
        Command.
    step : float
        Delay between copies [s].
    n : int
        Number of copies.
    name : str
        Prefix of the names.

    Notes
    -----
    Steps of the command stay steps. Before its first sample, the command equals its first sample.
    """
    copies = {}
    for k in range(n):
        t = np.append(channel.t[:1], channel.t + k * step)
        copies[f"{name}_{k}"] = Channel(t, np.append(channel.value[:1], channel.value), channel.unit, channel.source)
    return copies


def delay_step(model: Model) -> float:
    """Return the delay [s] between successive copies of the command."""
    return model.parameter("tau").bounds[1] / (sum(i.tap_of == COMMAND for i in model.inputs) - 1)


def pace_with_copy_at(tau: float, step: float) -> str:
    """Return the ``pace`` of a thruster model in which one of the copies of the command has exactly the delay ``tau``.

    Return an empty text if the delay is shorter than half of ``step``.

    Parameters
    ----------
    tau : float
        Delay [s].
    step : float
        Desired delay between copies [s].

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
    """Return the model of a thruster on the bench.

    Parameters
    ----------
    pace : str
        ``slow`` for delays beyond 0.6 s. Otherwise the delay [s] between copies of the command as text
        (``pace_with_copy_at``).
        Empty: ``step`` is used.
    force : bool
        Whether the bench has a load cell.
    swing : bool
        Whether the model has the disturbance force ``b_f``.
    step : float
        Delay between copies of the command [s].
    n_delays : int
        Number of copies.
    """
    step = SLOW_STEP if pace == "slow" else float(pace or step)
    top = step * (n_delays - 1)
    delay = Parameter("tau", min(0.1, top / 2), "s", "delay of the command", bounds=(0.0, top), step=0.005)
    states, sensors, parameters = _parts(force, force and swing)

    def reference(s: Signals) -> Any:
        """Return the delayed command outside the dead zone."""
        weights = enumerate(delay_weights(s.p.tau / step, n_delays))
        # Two to four weights of a numerical delay are not zero; weights of a symbolic delay are never skipped
        return sum(
            w * past_dead_zone(getattr(s.u, f"{COMMAND}_{k}"), s.p.d)
            for k, w in weights
            if not (isinstance(w, float) and w == 0.0)
        )

    def shaft(s: Signals) -> None:
        s.n_ref, s.n = reference(s), s.x.n

    return Model(
        "thruster",
        states,
        tuple(
            Input(f"{COMMAND}_{k}", label="" if k else COMMAND, tap_of=COMMAND, delay=k * step, prefilter=False)
            for k in range(n_delays)
        ),
        sensors,
        (delay, *parameters),
        (("shaft", shaft), ("thrust", _thrust), ("rate", _rate), ("output", _output)),
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
    """Return initial delays [s] and poles [1/s]. With low-rate telemetry, the likelihood has several maxima."""
    delays = np.arange(0.0, longest, START_DELAY_SPACING_S)
    return StartGrid(("tau", "a"), (tuple(delays.tolist()), tuple(START_POLES.tolist())), START_DELAY_SPACING_S)


def _parts(force: bool, swing: bool) -> tuple[tuple[State, ...], tuple[Sensor, ...], tuple[Parameter, ...]]:
    """Return states, sensors and parameters, with a load cell if ``force``, and with its
    disturbance force if ``swing``.
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


def past_dead_zone(command: Any, d: Any) -> Any:
    """Return the command outside the dead zone d, and zero inside it.

    A smooth step of width ``DEAD_ZONE_EDGE`` connects both parts.
    """
    along = np.minimum(np.maximum((abs(command) - d) / DEAD_ZONE_EDGE + 0.5, 0.0), 1.0)
    return command * along * along * (3.0 - 2.0 * along)


def delay_weights(position: Any, n: int) -> list[Any]:
    """Return weights of n samples for the value at ``position`` (0 to n - 1) between them, by cubic convolution.

    Beyond the ends, the samples are extrapolated linearly.
    """
    weights = [_keys(abs(position - k)) for k in range(n)]
    before, after = _keys(position + 1.0), _keys(float(n) - position)
    weights[0], weights[1] = weights[0] + 2.0 * before, weights[1] - before
    weights[-1], weights[-2] = weights[-1] + 2.0 * after, weights[-2] - after
    return weights


def _keys(s: Any) -> Any:
    """Return the kernel of cubic convolution at a distance s >= 0 (Keys 1981, eq. 15)."""
    near = 1.0 + s * s * (1.5 * s - 2.5)
    far = 2.0 + s * (-4.0 + s * (2.5 - 0.5 * s))
    return (s < 1.0) * near + (s >= 1.0) * (s < 2.0) * far


def _thrust(s: Signals) -> None:
    if hasattr(s.p, "c1"):
        s.force = s.p.c1 * s.n * abs(s.n) + s.p.c2 * s.n * s.n


def _rate(s: Signals) -> None:
    s.rate["n"] = s.p.a * (s.n_ref - s.x.n)
    if hasattr(s.x, "b_f"):
        s.rate["b_f"] = -s.x.b_f / s.p.tau_f


def _output(s: Signals) -> None:
    s.y["n"] = s.x.n
    if hasattr(s, "force"):
        s.y["force"] = s.force + s.p.bias + getattr(s.x, "b_f", 0.0)
