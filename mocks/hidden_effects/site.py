"""Hidden effects of place and mounting: shores, shoals, sheared currents, turned thrusters, payload, leak, weed."""

from __future__ import annotations

import math

import numpy as np

from seatrial.mocks.plant import Fouling, Growth, HiddenEffect, Line, Maker, Payload, ThrusterTruth, effect_size
from seatrial.mocks.plant import thrust as thrust_at_rest

STERN_M = -0.55  # position of the propellers forward of the origin


def _thrust_angle(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "thrust-angle": one thruster is turned in its mount.

    The thrust ``f`` of the left or the right thruster, drawn at random, gets the side force ``f sin(angle)`` at the
    stern, which gives a yaw moment too. ``f`` is the nominal static thrust at the shaft speed, and its forward part is
    not reduced. ``angle`` is drawn within 15 % of ``0.1 scale`` [rad] with a random sign, positive to starboard.
    """
    angle = scale * effect_size(rng, 0.10, signed=True)  # rad
    side = int(rng.integers(2))

    def jet(n_l: float, n_r: float) -> tuple[float, float]:
        """Return the sway force [N] and yaw moment [N m] of the turned thruster, at both shaft speeds (-1 to 1)."""
        sway = math.sin(angle) * thrust_at_rest(ThrusterTruth(), (n_l, n_r)[side])
        return sway, STERN_M * sway

    which = ("left", "right")[side]
    sentence = f"the {which} thruster is turned by {math.degrees(angle):.1f} deg in its mount"
    return HiddenEffect("thrust-angle", sentence, {"angle": angle, "right": float(side)}, jet=jet)


def _propeller_walk(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "propeller-walk": both propellers turn the same way and push the stern sideways.

    Each propeller with the shaft speed ``n`` has the sway force ``Y = -walk (41 N) n^2`` in reverse, and
    ``walk (41 N) n^2 / 3`` forward. The force acts at the stern, and so gives a yaw moment too. ``walk`` is drawn
    within 15 % of ``0.2 scale`` with a random sign.
    """
    walk = scale * effect_size(rng, 0.2, signed=True)

    def of_one(n: float) -> float:
        """Return the sway force [N] of one propeller at the shaft speed ``n``.

        Forward (``n`` above 0) it has a third of its size in reverse, and the opposite sign.
        """
        return walk * 41.0 * n * n * (-1.0 if n < 0.0 else 1.0 / 3.0)

    def jet(n_l: float, n_r: float) -> tuple[float, float]:
        """Return the sum of the sway forces [N] of both propellers, and its yaw moment [N m] about the origin."""
        sway = of_one(n_l) + of_one(n_r)
        return sway, STERN_M * sway

    sentence = "both propellers turn the same way, and astern they walk the stern sideways"
    return HiddenEffect("propeller-walk", sentence, {"walk": walk}, jet=jet)


def _current_shear(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "current-shear": the current is stronger away from the shore.

    With the distance ``d`` [m] from the origin across the stream (positive to the right of its direction), a velocity
    of ``jump tanh(d / 40 m)`` along the stream is added to the current. ``jump`` is drawn within 15 % of ``0.4 scale``
    [m/s], the direction uniformly.
    """
    jump, along = scale * effect_size(rng, 0.4), 2.0 * math.pi * rng.uniform()  # m/s, rad
    c, s = math.cos(along), math.sin(along)

    def stream(x: float, y: float) -> tuple[float, float]:
        """Return the change of the current [m/s], north and east, at a position [m].

        It is parallel to the stream, and zero at the start of the boat.
        """
        change = jump * math.tanh((c * y - s * x) / 40.0)
        return change * c, change * s

    sentence = f"the current changes by {jump / 40.0:.3f} m/s per metre across the stream"
    return HiddenEffect("current-shear", sentence, {"jump": jump, "along": along}, stream=stream)


def _bank(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "bank": a quay draws the boat towards it and turns the bow away.

    The quay is ``away`` = 12 m from the origin. At the distance ``d`` [m] from it (at least 0.5 m) and the surge
    velocity ``u``, a boat that moves along the quay is drawn with the sway force ``pull u^2 exp(-d / 10 m)`` and turned
    away with a moment of 0.35 m times this force. At another heading both are multiplied by the sine of the angle from
    the heading to the direction of the quay. ``pull`` is drawn within 15 % of ``35 scale`` [kg/m], the direction
    uniformly.
    """
    pull, bearing = scale * effect_size(rng, 35.0), 2.0 * math.pi * rng.uniform()  # kg/m, rad
    away = 12.0  # m
    c_b, s_b = math.cos(bearing), math.sin(bearing)

    def shore(x: float, y: float, c: float, s: float, u: float, v: float) -> tuple[float, float, float]:
        """Return X [N], zero, the sway force Y [N] towards the quay, and the yaw moment N [N m] away from it.

        ``x`` and ``y`` are the position [m], ``c`` and ``s`` cosine and sine of the heading, and ``u`` and ``v`` [m/s]
        the velocity through the water in body axes.
        """
        distance = max(away - c_b * x - s_b * y, 0.5)
        draw = pull * u * u * math.exp(-distance / 10.0) * (s_b * c - c_b * s)
        return 0.0, draw, -0.35 * draw

    sentence = f"a quay at {math.degrees(bearing):.0f} deg draws the boat and turns its bow away"
    return HiddenEffect("bank", sentence, {"pull": pull, "bearing": bearing, "away": away}, shore=shore)


def _shallow_water(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "shallow-water": drag grows over a shoal at one side of the area.

    The boat has the additional drag ``k h u |u|`` with ``h = (1 + tanh(d / 15 m)) / 2``. ``d`` [m] is the position of
    the boat in the direction of the shoal, so that ``h`` is 1/2 at the origin. ``k`` is drawn within 15 % of
    ``22 scale`` [kg/m], the direction uniformly.
    """
    k, bearing = scale * effect_size(rng, 22.0), 2.0 * math.pi * rng.uniform()  # kg/m, rad
    c_b, s_b = math.cos(bearing), math.sin(bearing)

    def shore(x: float, y: float, c: float, s: float, u: float, v: float) -> tuple[float, float, float]:
        """Return the additional drag X [N] at this position; Y [N] and N [N m] are zero.

        ``x`` and ``y`` are the position [m], ``c`` and ``s`` cosine and sine of the heading, and ``u`` and ``v`` [m/s]
        the velocity through the water in body axes.
        """
        return -k * 0.5 * (1.0 + math.tanh((c_b * x + s_b * y) / 15.0)) * u * abs(u), 0.0, 0.0

    sentence = f"over a shoal at {math.degrees(bearing):.0f} deg the boat drags more"
    return HiddenEffect("shallow-water", sentence, {"k": k, "bearing": bearing}, shore=shore)


def _payload_shift(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "payload-shift": a load slides fore or aft in every run.

    At ``at`` seconds after the start, the centre of gravity moves by ``x_g`` [m]. ``x_g`` is drawn within 15 % of
    ``0.12 scale`` with a random sign, and ``at`` within 15 % of 110 s.
    """
    x_g, at = scale * effect_size(rng, 0.12, signed=True), effect_size(rng, 110.0)  # m, s
    sentence = f"after {at:.0f} s the payload slides {'forward' if x_g > 0 else 'aft'}"
    return HiddenEffect("payload-shift", sentence, {"x_g": x_g, "at": at}, payload=Payload(at, x_g))


def _towed_line(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "towed-line": an umbilical trails behind the boat and is drawn through the water.

    ``drag``, the tension over the squared speed of its end, is drawn within 15 % of ``9 scale`` [N s2/m2]. ``length``
    is drawn within 15 % of 6 m.
    """
    drag, length = scale * effect_size(rng, 9.0), effect_size(rng, 6.0)  # N s2/m2, m
    sentence = f"the boat tows {length:.1f} m of umbilical"
    return HiddenEffect("towed-line", sentence, {"drag": drag, "length": length}, line=Line(length, drag, STERN_M))


def _leak(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "leak": water comes into the hull from the start of every run on.

    Mass and moment of inertia grow by the share ``rate t``. ``rate`` is drawn within 15 % of ``8e-4 scale`` [1/s].
    """
    rate = scale * effect_size(rng, 8e-4)  # 1/s
    sentence = f"the hull leaks: the mass grows by {6000.0 * rate:.1f} % in a minute"
    return HiddenEffect("leak", sentence, {"rate": rate}, growth=Growth(mass=rate))


def _growing_drag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "growing-drag": weed collects on the hull from the start of every run on.

    The surge damping grows by the share ``rate t``. ``rate`` is drawn within 15 % of ``3e-3 scale`` [1/s].
    """
    rate = scale * effect_size(rng, 3e-3)  # 1/s
    sentence = f"the boat collects weed: its surge drag grows by {6000.0 * rate:.0f} % in a minute"
    return HiddenEffect("growing-drag", sentence, {"rate": rate}, growth=Growth(drag=rate))


def _fouling(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "fouling": one propeller catches weed in every run.

    At ``at`` seconds after the start, the left thruster (``right`` 0) or the right one (``right`` 1) loses the share
    ``loss`` of its thrust. ``loss`` is drawn within 15 % of ``0.3 scale``, and ``at`` within 15 % of 110 s.
    """
    loss, at, is_right = scale * effect_size(rng, 0.3), effect_size(rng, 110.0), rng.random() < 0.5
    side = "right" if is_right else "left"
    return HiddenEffect(
        "fouling",
        f"after {at:.0f} s the {side} propeller catches weed",
        {"loss": loss, "at": at, "right": float(is_right)},
        fouling=Fouling(at, 0.0 if is_right else loss, loss if is_right else 0.0),
    )


MAKERS: dict[str, Maker] = {
    "thrust-angle": _thrust_angle,
    "propeller-walk": _propeller_walk,
    "current-shear": _current_shear,
    "bank": _bank,
    "shallow-water": _shallow_water,
    "payload-shift": _payload_shift,
    "towed-line": _towed_line,
    "leak": _leak,
    "growing-drag": _growing_drag,
    "fouling": _fouling,
}
