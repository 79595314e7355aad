"""What the boat does and nobody is told: effects that the nominal model lacks.

Each is physics written here for the plant alone; the forms need not equal those that an analysis tries. An effect is
drawn with its size within 15 % of the one named in its comment, and with a sign where it can have either.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mocks.noise import EFFECT_NAME, EFFECT_SIZE, stream

# thrust(n_left, n_right, advance_left, advance_right, f_left, f_right, energy) -> (f_left, f_right)
#   normalised shaft speeds, speed of each thruster through the water ahead (m/s), forces so far (N), energy used:
#   the integral of |n|^3 over time and both thrusters, in units of ENERGY_UNIT
Thrust = Callable[[float, float, float, float, float, float, float], tuple[float, float]]
# force(cos psi, sin psi, u_w, v_w, r, v_north, v_east) -> (X, Y, N): velocity through the water in body axes, over
#   ground in NED; N, N, N m
Force = Callable[[float, float, float, float, float, float, float], tuple[float, float, float]]

ENERGY_UNIT = 150.0  # s, what a mission of ten minutes uses


@dataclass(frozen=True)
class Effect:
    """One effect: where it acts, its true parameters (SI) and a sentence for people."""

    name: str
    sentence: str
    parameters: dict[str, float] = field(default_factory=dict)
    thrust: Thrust | None = None
    force: Force | None = None
    x_g: float = 0.0  # m, centre of gravity ahead of the origin
    pendulum: tuple[float, float, float] | None = None  # kg, m, 1/s
    compass: Callable[[float], float] | None = None  # heading -> deviation, rad
    lever_arm: tuple[float, float] | None = None  # m, GNSS antenna forward and starboard
    latency: float = 0.0  # s, of the GNSS


Maker = Callable[[np.random.Generator, float], Effect]


def _size(rng: np.random.Generator, size: float, *, signed: bool = False) -> float:
    """``size`` within 15 %, of either sign when ``signed``."""
    sign = -1.0 if signed and rng.uniform() < 0.5 else 1.0
    return float(sign * size * rng.uniform(0.85, 1.15))


def _advance_ratio(rng: np.random.Generator, scale: float) -> Effect:
    k = scale * _size(rng, 7.0)  # N s/m: at n = 0.6 and 1 m/s 3 of 14 N are lost

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        loss_l = k * abs(n_l) * a_l / (1.0 + 0.35 * abs(a_l))
        loss_r = k * abs(n_r) * a_r / (1.0 + 0.35 * abs(a_r))
        return f_l - loss_l, f_r - loss_r

    return Effect("advance-ratio", "the propellers lose thrust as the boat moves ahead", {"k": k}, thrust=thrust)


def _reverse_thrust(rng: np.random.Generator, scale: float) -> Effect:
    loss = scale * _size(rng, 0.40)  # 0.29 of the thrust at n = -0.5

    def factor(n: float) -> float:
        return 1.0 if n >= 0.0 else 1.0 - loss * (1.0 - math.exp(2.5 * n))

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        return f_l * factor(n_l), f_r * factor(n_r)

    sentence = "astern the jets strike the hull and part of the thrust is lost; the bench does not show it"
    return Effect("reverse-thrust", sentence, {"loss": loss}, thrust=thrust)


def _mismatch(rng: np.random.Generator, scale: float) -> Effect:
    eps = scale * _size(rng, 0.05, signed=True)

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        return f_l * (1.0 + eps * (0.8 + 0.3 * abs(n_l))), f_r * (1.0 - eps * (0.8 + 0.3 * abs(n_r)))

    stronger = "left" if eps > 0.0 else "right"
    return Effect("mismatch", f"the {stronger} thruster is the stronger one", {"eps": eps}, thrust=thrust)


def _thruster_interaction(rng: np.random.Generator, scale: float) -> Effect:
    kappa = scale * _size(rng, 0.17)

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        return f_l * (1.0 - kappa * abs(n_r) ** 1.3), f_r * (1.0 - kappa * abs(n_l) ** 1.3)

    sentence = "each thruster draws from the water that the other has set in motion"
    return Effect("thruster-interaction", sentence, {"kappa": kappa}, thrust=thrust)


def _battery_sag(rng: np.random.Generator, scale: float) -> Effect:
    beta = scale * _size(rng, 0.20)  # 0.16 of the thrust after a mission of ten minutes

    def thrust(
        n_l: float, n_r: float, a_l: float, a_r: float, f_l: float, f_r: float, energy: float
    ) -> tuple[float, float]:
        gain = 1.0 - beta * (1.0 - math.exp(-1.6 * energy))
        return gain * f_l, gain * f_r

    return Effect("battery-sag", "thrust fades as the battery is used up", {"beta": beta}, thrust=thrust)


def _wind(rng: np.random.Generator, scale: float) -> Effect:
    drag = scale * 0.28  # N s2/m2, broadside
    speed = _size(rng, 5.3)  # m/s: 8 N broadside
    toward = 2.0 * math.pi * rng.uniform()
    w_n, w_e = speed * math.cos(toward), speed * math.sin(toward)

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        rel_n, rel_e = w_n - v_n, w_e - v_e
        ahead, aside = c * rel_n + s * rel_e, c * rel_e - s * rel_n
        speed = math.hypot(ahead, aside)
        return 0.7 * drag * speed * ahead, drag * speed * aside, 0.2 * drag * ahead * aside

    came_from = math.degrees(toward + math.pi) % 360.0
    return Effect(
        "wind",
        f"a steady wind of {speed:.1f} m/s blows from {came_from:.0f} deg",
        {"wind_n": w_n, "wind_e": w_e, "drag": drag},
        force=force,
    )


def _sway_yaw(rng: np.random.Generator, scale: float) -> Effect:
    y_r = scale * _size(rng, 8.0, signed=True)  # N s at 0.75 m/s
    n_v = math.copysign(scale * _size(rng, 3.0), y_r)  # N s

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        gain = 0.4 + 0.8 * abs(u)
        return 0.0, -y_r * gain * r, -n_v * gain * v

    sentence = "sway and yaw are damped together: the hull is not alike fore and aft"
    return Effect("sway-yaw", sentence, {"y_r": y_r, "n_v": n_v}, force=force)


def _turning_resistance(rng: np.random.Generator, scale: float) -> Effect:
    k = scale * _size(rng, 7.5)  # N at 1 rad/s

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        return -k * abs(r) ** 1.7, 0.0, 0.0

    return Effect("turning-resistance", "turning costs speed ahead", {"k": k}, force=force)


def _cubic_drag(rng: np.random.Generator, scale: float) -> Effect:
    k = scale * _size(rng, 11.0)  # N at 1 m/s

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        return -k * u * abs(u) ** 2.2, 0.0, 0.0

    return Effect("cubic-drag", "the bow wave makes drag grow faster than the square of speed", {"k": k}, force=force)


def _yaw_bias(rng: np.random.Generator, scale: float) -> Effect:
    n_0 = scale * _size(rng, 0.28, signed=True)  # N m

    def force(c: float, s: float, u: float, v: float, r: float, v_n: float, v_e: float) -> tuple[float, float, float]:
        return 0.0, 0.0, n_0 * (0.8 + 0.3 * abs(u))

    side = "starboard" if n_0 > 0.0 else "port"
    return Effect("yaw-bias", f"something on the hull pulls it to {side}", {"n_0": n_0}, force=force)


def _cg_offset(rng: np.random.Generator, scale: float) -> Effect:
    x_g = scale * _size(rng, 0.13, signed=True)  # m of the rigid mass of 17 kg
    where = "ahead of" if x_g > 0.0 else "behind"
    return Effect("cg-offset", f"the centre of gravity lies {where} amidships", {"x_g": x_g}, x_g=x_g)


def _compass(rng: np.random.Generator, scale: float) -> Effect:
    b, c = scale * _size(rng, 0.045, signed=True), scale * _size(rng, 0.03, signed=True)  # rad
    d = scale * _size(rng, 0.006, signed=True)

    def compass(psi: float) -> float:
        return b * math.sin(psi) + c * math.cos(psi) + d * math.sin(2.0 * psi)

    sentence = "iron on board deviates the compass, by an angle that depends on heading"
    return Effect("compass", sentence, {"b_sin": b, "c_cos": c, "d_sin2": d}, compass=compass)


def _lever_arm(rng: np.random.Generator, scale: float) -> Effect:
    ahead, aside = scale * _size(rng, 0.5, signed=True), scale * _size(rng, 0.15, signed=True)  # m
    sentence = "the GNSS antenna is not where the rig file says"
    return Effect("lever-arm", sentence, {"l_x": ahead, "l_y": aside}, lever_arm=(ahead, aside))


def _gnss_latency(rng: np.random.Generator, scale: float) -> Effect:
    latency = scale * _size(rng, 0.35)  # s
    sentence = "the GNSS receiver filters and delivers old fixes as if they were new"
    return Effect("gnss-latency", sentence, {"latency": latency}, latency=latency)


def _pendulum(rng: np.random.Generator, scale: float) -> Effect:
    mass, frequency = scale * _size(rng, 5.0), _size(rng, 0.55)  # kg, Hz
    omega = 2.0 * math.pi * frequency
    length, damping = 9.81 / omega**2, 2.0 * 0.06 * omega
    return Effect(
        "pendulum",
        f"{mass:.1f} kg hang in the hull and swing fore and aft at {frequency:.2f} Hz when it gathers way",
        {"mass": mass, "frequency_hz": frequency, "damping_ratio": 0.06},
        pendulum=(mass, length, damping),
    )


EFFECTS: dict[str, Maker] = {
    "advance-ratio": _advance_ratio,
    "reverse-thrust": _reverse_thrust,
    "mismatch": _mismatch,
    "wind": _wind,
    "sway-yaw": _sway_yaw,
    "turning-resistance": _turning_resistance,
    "cubic-drag": _cubic_drag,
    "cg-offset": _cg_offset,
    "compass": _compass,
    "lever-arm": _lever_arm,
    "gnss-latency": _gnss_latency,
    "battery-sag": _battery_sag,
    "yaw-bias": _yaw_bias,
    "thruster-interaction": _thruster_interaction,
    "pendulum": _pendulum,
}

# What `--effect draw` draws from: each shows in five minutes of a mixed mission and has no near relative in the list.
DEMO = (
    "advance-ratio",
    "mismatch",
    "wind",
    "turning-resistance",
    "cubic-drag",
    "compass",
    "lever-arm",
    "gnss-latency",
    "yaw-bias",
    "pendulum",
)


def make_effect(name: str, seed: int, scale: float = 1.0) -> Effect:
    """The effect ``name`` (KeyError if there is none) as ``seed`` draws it, ``scale`` times its full size."""
    maker = EFFECTS[name]
    return maker(stream(seed, EFFECT_SIZE, index=list(EFFECTS).index(name)), scale)


def draw_name(seed: int, names: tuple[str, ...] = DEMO) -> str:
    """The name that ``--effect draw`` takes at this seed."""
    return names[int(stream(seed, EFFECT_NAME).integers(len(names)))]
