"""Hidden effects of the environment: wind, changing current, tether, waves and swell."""

from __future__ import annotations

import math

import numpy as np

from seatrial.mocks.plant import HiddenEffect, Maker, Wave, effect_size


def _wind(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "wind": the force of a steady wind on the boat.

    With the apparent wind ``w = (w_x, w_y)`` [m/s] in body axes and the coefficient ``k = 0.28 scale`` [N s2/m2]::

        X = 0.7 k |w| w_x,  Y = k |w| w_y,  N = 0.2 k w_x w_y

    The true wind speed is drawn within 15 % of 5.3 m/s whatever ``scale`` is, and its direction uniformly.
    """
    drag = scale * 0.28  # N s2/m2, broadside
    speed = effect_size(rng, 5.3)  # m/s: 8 N broadside
    toward = 2.0 * math.pi * rng.uniform()
    w_n, w_e = speed * math.cos(toward), speed * math.sin(toward)

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return the force X, Y [N] and moment N [N m] of the wind on the moving boat, in body axes.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        rel_n, rel_e = w_n - v_n, w_e - v_e
        forward, starboard = c * rel_n + s * rel_e, c * rel_e - s * rel_n
        speed = math.hypot(forward, starboard)
        return 0.7 * drag * speed * forward, drag * speed * starboard, 0.2 * drag * forward * starboard

    came_from = math.degrees(toward + math.pi) % 360.0
    return HiddenEffect(
        "wind",
        f"a steady wind of {speed:.1f} m/s blows from {came_from:.0f} deg",
        {"wind_n": w_n, "wind_e": w_e, "drag": drag},
        force=force,
    )


def _current_drift(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "current-drift": a slow change of the ocean current, as at the turn of a tide.

    A vector [m/s] times the factor ``0.5 tanh((t - 200 s) / 180 s)`` is added to the constant current. The length of
    the vector is drawn within 15 % of ``0.22 scale``, and its direction uniformly.
    """
    change, toward = scale * effect_size(rng, 0.22), 2.0 * math.pi * rng.uniform()  # m/s
    north, east = change * math.cos(toward), change * math.sin(toward)

    def current(t: float) -> tuple[float, float]:
        """Return the change of the current [m/s], north and east, at ``t`` [s] after the start.

        It is zero at 200 s, and has opposite signs before and after.
        """
        part = 0.5 * math.tanh((t - 200.0) / 180.0)
        return part * north, part * east

    sentence = f"the tide turns: the current changes by {0.8 * change:.2f} m/s in 400 s"
    return HiddenEffect("current-drift", sentence, {"change_n": north, "change_e": east}, current=current)


def _tether(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "tether": the drag of a line from the boat to its starting point.

    With the distance ``d`` [m] from the start and the velocity ``v`` [m/s] over ground::

        force = -k d^2 / (d + slack) |v| v

    ``k`` [N s2/m3] is drawn within 15 % of ``0.08 scale``, and ``slack`` is 8 m.
    """
    k = scale * effect_size(rng, 0.08)  # N s2/m3
    slack = 8.0  # m

    def tether(x: float, y: float, v_n: float, v_e: float) -> tuple[float, float]:
        """Return the force of the line [N], north and east, at a position [m] and velocity over ground [m/s].

        The force acts against the velocity, and is zero at the start of the boat.
        """
        away = math.hypot(x, y)
        paid_out = away * away / (away + slack)
        pull = k * paid_out * math.hypot(v_n, v_e)
        return -pull * v_n, -pull * v_e

    sentence = "a line to the shore drags the more, the more of it is in the water"
    return HiddenEffect("tether", sentence, {"k": k, "slack": slack}, tether=tether)


def _waves(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "waves": the forces of irregular waves with a narrow spectrum.

    The forces are sums of sines (``Sea`` in seatrial.mocks.plant.weather). The peak frequency is drawn within 15 % of
    0.45 Hz, and the direction uniformly. The standard deviations are drawn within 15 % of ``7 scale`` [N] in surge,
    ``6 scale`` [N] in sway and ``0.7 scale`` [N m] in yaw.
    """
    frequency, toward = effect_size(rng, 0.45), 2.0 * math.pi * rng.uniform()  # Hz, rad
    wave = Wave(
        frequency,
        0.12,
        toward,
        scale * effect_size(rng, 7.0),
        scale * effect_size(rng, 6.0),
        scale * effect_size(rng, 0.7),
    )
    came_from = math.degrees(toward + math.pi) % 360.0
    parameters = {"frequency_hz": frequency, "surge": wave.surge, "sway": wave.sway, "yaw": wave.yaw}
    sentence = f"waves of {frequency:.2f} Hz come from {came_from:.0f} deg"
    return HiddenEffect("waves", sentence, parameters, wave=wave)


def _heading_moment(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "heading-moment": a yaw moment with two cycles per turn, as a long swell causes it.

    With ``a = psi - at``::

        N = n sin(2 a) / (1 + 0.3 cos(a))

    ``n`` [N m] is drawn within 15 % of ``0.5 scale``, and the heading ``at`` [rad] uniformly.
    """
    n, at = scale * effect_size(rng, 0.5), 2.0 * math.pi * rng.uniform()  # N m

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return the forces X and Y [N], zero, and the yaw moment N [N m] at this heading.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        along, across = c * math.cos(at) + s * math.sin(at), s * math.cos(at) - c * math.sin(at)
        return 0.0, 0.0, n * 2.0 * along * across / (1.0 + 0.3 * along)

    sentence = "a moment turns the boat towards two headings, as a long swell does"
    return HiddenEffect("heading-moment", sentence, {"n": n, "at": at}, force=force)


MAKERS: dict[str, Maker] = {
    "wind": _wind,
    "current-drift": _current_drift,
    "tether": _tether,
    "waves": _waves,
    "heading-moment": _heading_moment,
}
