"""Hidden effects of the hull: additional damping, lift, a moved centre of gravity and a swinging payload."""

from __future__ import annotations

import math

import numpy as np

from seatrial.mocks.plant import HiddenEffect, Maker, effect_size


def _sway_yaw(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "sway-yaw": coupled damping of sway and yaw, as of a hull that differs fore and aft.

    With ``g = 0.4 + 0.8 |u|``::

        Y = -y_r g r,  N = -n_v g v

    ``y_r`` [N s] is drawn within 15 % of ``8 scale`` with a random sign. ``n_v`` [N s] is drawn within 15 % of
    ``3 scale`` and has the sign of ``y_r``.
    """
    y_r = scale * effect_size(rng, 8.0, signed=True)  # N s at 0.75 m/s
    # With the sign of y_r, since both have the same cause.
    n_v = math.copysign(scale * effect_size(rng, 3.0), y_r)  # N s

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return X [N], zero, the sway force Y [N] by the yaw rate, and the yaw moment N [N m] by ``v``.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        gain = 0.4 + 0.8 * abs(u)
        return 0.0, -y_r * gain * r, -n_v * gain * v

    sentence = "sway and yaw are damped together: the hull is not alike fore and aft"
    return HiddenEffect("sway-yaw", sentence, {"y_r": y_r, "n_v": n_v}, force=force)


def _turning_resistance(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "turning-resistance": a resistance in surge that grows with the yaw rate.

    The force is ``X = -k |r|^1.7``. ``k``, in N at 1 rad/s, is drawn within 15 % of ``7.5 scale``.
    """
    k = scale * effect_size(rng, 7.5)  # N at 1 rad/s

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return the resistance X [N] by the yaw rate; Y [N] and N [N m] are zero.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return -k * abs(r) ** 1.7, 0.0, 0.0

    return HiddenEffect("turning-resistance", "turning costs forward speed", {"k": k}, force=force)


def _cubic_drag(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "cubic-drag": an additional drag that grows faster than the square of the speed.

    The force is ``X = -k u |u|^2.2``. ``k``, in N at 1 m/s, is drawn within 15 % of ``11 scale``.
    """
    k = scale * effect_size(rng, 11.0)  # N at 1 m/s

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return the additional drag X [N] at the surge velocity ``u``; Y [N] and N [N m] are zero.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return -k * u * abs(u) ** 2.2, 0.0, 0.0

    return HiddenEffect(
        "cubic-drag", "the bow wave makes drag grow faster than the square of speed", {"k": k}, force=force
    )


def _yaw_bias(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "yaw-bias": a yaw moment that is almost constant.

    The moment is ``N = n_0 (0.8 + 0.3 |u|)``. ``n_0`` [N m] is drawn within 15 % of ``0.28 scale`` with a random sign.
    """
    n_0 = scale * effect_size(rng, 0.28, signed=True)  # N m

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return X and Y [N], zero, and the almost constant yaw moment N [N m].

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return 0.0, 0.0, n_0 * (0.8 + 0.3 * abs(u))

    side = "starboard" if n_0 > 0.0 else "port"
    return HiddenEffect("yaw-bias", f"something on the hull pulls it to {side}", {"n_0": n_0}, force=force)


def _cg_offset(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "cg-offset": a centre of gravity that lies ``x_g`` [m] forward of the body's origin.

    The offset of the rigid-body mass couples sway and yaw in the equations of motion (``make_rhs`` in
    seatrial.mocks.plant.hull). ``x_g`` is drawn within 15 % of ``0.13 scale`` with a random sign; negative is aft.
    """
    x_g = scale * effect_size(rng, 0.13, signed=True)  # m; offset of the rigid mass of 17 kg
    where = "forward of" if x_g > 0.0 else "behind"
    return HiddenEffect("cg-offset", f"the centre of gravity lies {where} amidships", {"x_g": x_g}, x_g=x_g)


def _pendulum(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "pendulum": a payload that hangs in the hull and swings fore and aft.

    With the length ``l = g / omega^2``, the damping ``d = 2 zeta omega``, ``zeta = 0.06``, and the angle ``theta``::

        theta'' = -d theta' - (g sin(theta) + (u' - v r) cos(theta)) / l
        X = mass (g sin(theta) cos(theta) + d l theta' - v r)

    The equations of motion add the force and remove the mass of the payload from the mass in surge. ``mass`` [kg] is
    drawn within 15 % of ``5 scale``, and the natural frequency ``omega / 2 pi`` within 15 % of 0.55 Hz.
    """
    mass, frequency = scale * effect_size(rng, 5.0), effect_size(rng, 0.55)  # kg, Hz
    omega = 2.0 * math.pi * frequency
    length, damping = 9.81 / omega**2, 2.0 * 0.06 * omega
    return HiddenEffect(
        "pendulum",
        f"{mass:.1f} kg hang in the hull and swing fore and aft at {frequency:.2f} Hz when it gathers way",
        {"mass": mass, "frequency_hz": frequency, "damping_ratio": 0.06},
        pendulum=(mass, length, damping),
    )


def _cross_flow(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "cross-flow": the drag of the cross-flow along the hull in a turn.

    The equations are ``Y = -d_vr |r|^1.15 v`` and ``N = -n_vr sqrt(v^2 + 0.05^2) r``. ``d_vr`` [kg] is drawn within
    15 % of ``40 scale``, and ``n_vr`` [kg m] within 15 % of ``10 scale``.
    """
    d_vr = scale * effect_size(rng, 40.0)  # kg
    n_vr = scale * effect_size(rng, 10.0)  # kg m

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return X [N], zero, and the damping of sway, Y [N], and of yaw, N [N m], by the cross-flow.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return 0.0, -d_vr * abs(r) ** 1.15 * v, -n_vr * math.hypot(v, 0.05) * r

    sentence = "in turns the cross-flow along the hull damps sway and yaw more than either alone would"
    return HiddenEffect("cross-flow", sentence, {"d_vr": d_vr, "n_vr": n_vr}, force=force)


def _lift(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "lift": the lift of the skegs, which damps sway and yaw in proportion to the speed.

    With ``g = u^2 / sqrt(u^2 + 0.15^2)``, which is ``|u|`` except near zero::

        Y = -y_uv g v,  N = -n_ur g r

    ``y_uv`` [kg/m] is drawn within 15 % of ``30 scale``, and ``n_ur`` [kg m] within 15 % of ``9 scale``.
    """
    y_uv, n_ur = scale * effect_size(rng, 30.0), scale * effect_size(rng, 9.0)  # kg/m, kg m

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return X [N], zero, and the damping of sway, Y [N], and of yaw, N [N m], by the lift of the skegs.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        gain = u * u / math.hypot(u, 0.15)
        return 0.0, -y_uv * gain * v, -n_ur * gain * r

    sentence = "the skegs lift: sway and yaw are damped the more, the faster the boat goes"
    return HiddenEffect("lift", sentence, {"y_uv": y_uv, "n_ur": n_ur}, force=force)


def _hump(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "hump": an additional drag around one speed, as of the boat's own wave.

    The force is ``X = -height / cosh((|u| - speed) / width)^2 tanh(u / 0.2)``. ``height`` [N] is drawn within 15 % of
    ``7 scale``, ``speed`` [m/s] within 15 % of 0.8, and ``width`` is 0.17 m/s.
    """
    height, speed, width = scale * effect_size(rng, 7.0), effect_size(rng, 0.80), 0.17  # N, m/s, m/s

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return the additional drag X [N] around one speed, against the motion; Y [N] and N [N m] are zero.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return -height / math.cosh((abs(u) - speed) / width) ** 2 * math.tanh(u / 0.2), 0.0, 0.0

    sentence = f"at {speed:.2f} m/s the boat sits in the trough of its own wave, and drag has a hump there"
    return HiddenEffect("hump", sentence, {"height": height, "speed": speed, "width": width}, force=force)


def _coulomb(rng: np.random.Generator, scale: float) -> HiddenEffect:
    """Return the hidden effect "coulomb": a friction that hardly depends on the speed.

    The force is ``X = -f u / sqrt(u^2 + 0.06^2)``, which is ``-f`` or ``f`` except near rest. ``f`` [N] is drawn within
    15 % of ``4 scale``.
    """
    friction = scale * effect_size(rng, 4.0)  # N

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        """Return the friction X [N] against the surge velocity ``u``; Y [N] and N [N m] are zero.

        ``c`` and ``s`` are cosine and sine of the heading, ``u`` and ``v`` [m/s] the velocity through the water in body
        axes, ``r`` [rad/s] the yaw rate, and ``v_n`` and ``v_e`` [m/s] the velocity over ground, north and east.
        """
        return -friction * u / math.hypot(u, 0.06), 0.0, 0.0

    return HiddenEffect(
        "coulomb", "weed drags along with a force that speed does not change", {"f": friction}, force=force
    )


MAKERS: dict[str, Maker] = {
    "sway-yaw": _sway_yaw,
    "turning-resistance": _turning_resistance,
    "cubic-drag": _cubic_drag,
    "cg-offset": _cg_offset,
    "yaw-bias": _yaw_bias,
    "pendulum": _pendulum,
    "cross-flow": _cross_flow,
    "lift": _lift,
    "hump": _hump,
    "coulomb": _coulomb,
}
