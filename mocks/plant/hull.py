"""Equations of motion of the simulated boat.

The rigid-body mass moves with the velocity over ground. Added mass and damping act on the velocity through the water
(Fossen 2011, eq. 6.102-6.112 and 8.5). The body axes point forward, to starboard and down; their origin is amidships.
The current is constant in the NED frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

from seatrial.mocks.plant.effect import HiddenEffect
from seatrial.mocks.plant.thruster import ThrusterTruth
from seatrial.mocks.random_streams import CURRENT, PARAMETERS, random_stream

GRAVITY = 9.81  # m/s2

# (x, y, psi, u, v, r, angle, rate): position NED in m, heading in rad, velocity over ground in body axes in m/s, yaw
# rate in rad/s; angle (rad) and rate (rad/s) of the swinging payload of the hidden effect "pendulum".
State = tuple[float, float, float, float, float, float, float, float]
AT_REST: State = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

# rhs(state, n_left, n_right, energy, X, Y, N) -> time derivative of the state
Rhs = Callable[[State, float, float, float, float, float, float], State]


@dataclass(frozen=True)
class Hull:
    """True parameters of the hull of a simulated boat.

    The defaults, except `d_vv`, are the nominal values of table 1 of the thesis. Rigid-body and added masses are
    separated as in DSOR's mred_sim.yaml.

    Attributes
    ----------
    mass : float
        Rigid-body mass [kg].
    inertia : float
        Rigid-body moment of inertia in yaw about the centre of gravity [kg m2].
    added_u, added_v, added_r : float
        Added mass in surge [kg] and sway [kg], added moment of inertia in yaw [kg m2].
    d_u, d_v, d_r : float
        Linear damping in surge [kg/s], sway [kg/s] and yaw [kg m2/s].
    d_uu, d_vv, d_rr : float
        Quadratic damping in surge [kg/m], sway [kg/m] and yaw [kg m2].
    """

    mass: float = 17.0
    inertia: float = 9.19
    added_u: float = 20.0
    added_v: float = 30.0
    added_r: float = 0.5
    d_u: float = 0.2
    d_uu: float = 25.0
    d_v: float = 50.0
    d_vv: float = 20.0  # the thesis prints 0.01, with which the damping in sway would be almost linear
    d_r: float = 4.14
    d_rr: float = 6.23

    def lumped(self) -> dict[str, float]:
        """Return the hull's parameters in the form of the thesis' model, by name.

        m_u, m_v and m_r [kg, kg, kg m2] are sums of the rigid-body and the added mass (inertia). The damping
        parameters d_u, d_uu, d_v, d_vv, d_r and d_rr are the fields of the same name.
        """
        return {
            "m_u": self.mass + self.added_u,
            "m_v": self.mass + self.added_v,
            "m_r": self.inertia + self.added_r,
            **{name: getattr(self, name) for name in ("d_u", "d_uu", "d_v", "d_vv", "d_r", "d_rr")},
        }


ARM = 0.15  # m, thrusters at y = -ARM (left) and +ARM (right)
CURRENT_MAX = 0.25  # m/s, largest speed of the current


def draw_hull(seed: int, spread: float = 0.10) -> Hull:
    """Return the parameters of the simulated hull that belongs to a seed.

    Each parameter is its nominal value times a factor of its own, which is uniform between ``1 - spread`` and
    ``1 + spread``. The same seed gives the same hull.
    """
    nominal = Hull()
    factors = 1.0 + spread * random_stream(seed, PARAMETERS).uniform(-1.0, 1.0, len(fields(Hull)))
    return replace(
        nominal,
        **{f.name: getattr(nominal, f.name) * float(k) for f, k in zip(fields(Hull), factors, strict=True)},
    )


def draw_current(seed: int) -> tuple[float, float]:
    """Return the ocean current of the simulated boat that belongs to a seed: its velocity [m/s], north and east.

    The speed is uniform between 0 and CURRENT_MAX (0.25 m/s), and the direction is uniform.
    """
    rng = random_stream(seed, CURRENT)
    speed, toward = CURRENT_MAX * rng.uniform(), 2.0 * math.pi * rng.uniform()
    return speed * math.cos(toward), speed * math.sin(toward)


Pair = tuple[float, float]
Triple = tuple[float, float, float]
# forces(state, velocity through the water (body axes), velocity over ground (NED), (cos psi, sin psi), shaft speeds
# (left, right), forces without it) -> (X, Y, N)
EffectForces = Callable[[State, Pair, Pair, Pair, Pair, Triple], Triple]


def _effect_forces(effects: Sequence[HiddenEffect]) -> EffectForces | None:
    """Return a function that adds the forces of the hidden ``effects`` to those on the boat (`EffectForces`).

    The result is None if no effect has a force. Effects that change the thrust are not among them.
    """
    force_hooks = [e.force for e in effects if e.force is not None]
    jets = [e.jet for e in effects if e.jet is not None]
    tethers = [e.tether for e in effects if e.tether is not None]
    shores = [e.shore for e in effects if e.shore is not None]
    if not (force_hooks or jets or tethers or shores):
        return None

    def forces(s: State, water: Pair, ground: Pair, turn: Pair, n: Pair, others: Triple) -> Triple:
        """Return the sum of all forces on the boat: X, Y [N] and the yaw moment N [N m].

        ``s`` is the state. ``water`` [m/s] is the velocity through the water in body axes, and ``ground`` [m/s] that
        over ground, north and east. ``turn`` has cosine and sine of the heading, and ``n`` the shaft speeds, left and
        right. ``others`` has the forces X, Y, N without those of hidden effects.
        """
        (u_w, v_w), (vel_n, vel_e), (c, si), (n_l, n_r) = water, ground, turn, n
        x_force, y_force, n_moment = others
        for extra in force_hooks:
            x_extra, y_extra, n_extra = extra(c, si, u_w, v_w, s[5], vel_n, vel_e)
            x_force, y_force, n_moment = x_force + x_extra, y_force + y_extra, n_moment + n_extra
        for jet in jets:
            sway, yaw = jet(n_l, n_r)
            y_force, n_moment = y_force + sway, n_moment + yaw
        for tether in tethers:
            pull_n, pull_e = tether(s[0], s[1], vel_n, vel_e)
            x_force, y_force = x_force + c * pull_n + si * pull_e, y_force + c * pull_e - si * pull_n
        for shore in shores:
            x_extra, y_extra, n_extra = shore(s[0], s[1], c, si, u_w, v_w)
            x_force, y_force, n_moment = x_force + x_extra, y_force + y_extra, n_moment + n_extra
        return x_force, y_force, n_moment

    return forces


def make_rhs(
    hull: Hull, thruster: ThrusterTruth, current: Sequence[float], effects: Sequence[HiddenEffect] = ()
) -> Rhs:
    """Return a function that computes the time derivative of a boat's state: its equations of motion.

    Parameters
    ----------
    hull : Hull
        Masses and damping of the boat.
    thruster : ThrusterTruth
        Thrust coefficients of both thrusters.
    current : sequence of two floats
        Velocity of the current [m/s], north and east. The caller may change the values between steps, but slowly:
        the equations neglect the acceleration of the current.
    effects : sequence of HiddenEffect
        Hidden effects whose hooks act on forces and masses. Forces and offsets of the centre of gravity of several
        effects add up; thrust hooks act one after the other. Only the first swinging payload is used.

    Returns
    -------
    callable
        Function of the state (x, y, psi, u, v, r, and angle and rate of a swinging payload), the shaft speeds of the
        left and the right thruster (normalised), the used energy in units of ENERGY_UNIT, and the external forces X, Y,
        N [N, N, N m]. It returns the time derivative of the state.

    Notes
    -----
    The function is one closure over plain floats because a mock at speed 20 calls it about 16,000 times a second.
    """
    sin, cos, effect_forces = math.sin, math.cos, _effect_forces(effects)
    c1, c2 = thruster.c1, thruster.c2
    d_u, d_uu, d_v, d_vv, d_r, d_rr = hull.d_u, hull.d_uu, hull.d_v, hull.d_vv, hull.d_r, hull.d_rr
    thrust_hooks = [e.thrust for e in effects if e.thrust is not None]
    m, xa, ya = hull.mass, hull.added_u, hull.added_v
    x_g = sum(e.x_g for e in effects)
    m_u, m_v, m_r = m + xa, m + ya, hull.inertia + m * x_g * x_g + hull.added_r
    m_xg = m * x_g
    det = m_v * m_r - m_xg * m_xg
    bob = next((e.pendulum for e in effects if e.pendulum is not None), None)
    bob_mass, bob_length, bob_damping = bob if bob is not None else (0.0, 1.0, 0.0)

    def rhs(s: State, n_l: float, n_r: float, energy: float, x_force: float, y_force: float, n_moment: float) -> State:
        """Return the time derivative of the boat's state ``s``.

        ``n_l`` and ``n_r`` are the shaft speeds (-1 to 1), ``energy`` is the used energy in units of ENERGY_UNIT, and
        the others are external forces [N, N, N m].
        """
        _, _, psi, u, v, r, angle, rate = s
        c, si = cos(psi), sin(psi)
        v_n, v_e = current
        u_c, v_c = c * v_n + si * v_e, c * v_e - si * v_n
        u_w, v_w = u - u_c, v - v_c  # through the water
        vel_n, vel_e = c * u - si * v, si * u + c * v
        f_l, f_r = (c1 * abs(n_l) + c2 * n_l) * n_l, (c1 * abs(n_r) + c2 * n_r) * n_r
        for modify in thrust_hooks:
            f_l, f_r = modify(n_l, n_r, u_w + ARM * r, u_w - ARM * r, f_l, f_r, energy)
        x = x_force + (f_l + f_r - (d_u + d_uu * abs(u_w)) * u_w)
        y = y_force - (d_v + d_vv * abs(v_w)) * v_w
        n = n_moment + (ARM * (f_l - f_r) - (d_r + d_rr * abs(r)) * r)
        if effect_forces is not None:
            x, y, n = effect_forces(s, (u_w, v_w), (vel_n, vel_e), (c, si), (n_l, n_r), (x, y, n))
        if bob_mass:
            # The swinging payload is part of the boat's mass, but it moves freely fore and aft.
            x += bob_mass * (GRAVITY * sin(angle) * cos(angle) + bob_damping * bob_length * rate - v * r)
        u_dot = (x + m * (v + x_g * r) * r + xa * r * v_c + ya * v_w * r) / (m_u - bob_mass)
        sway = y - m * u * r - ya * r * u_c - xa * u_w * r
        yaw = n - m_xg * u * r - (ya - xa) * u_w * v_w
        v_dot = (m_r * sway - m_xg * yaw) / det
        r_dot = (m_v * yaw - m_xg * sway) / det
        swing = 0.0
        if bob_mass:
            swing = -bob_damping * rate - (GRAVITY * sin(angle) + (u_dot - v * r) * cos(angle)) / bob_length
        return (vel_n, vel_e, r, u_dot, v_dot, r_dot, rate, swing)

    return rhs


def rk4(
    rhs: Rhs,
    s: State,
    k1: State,
    h: float,
    n: tuple[float, float, float, float],
    energy: float,
    forces: tuple[float, float, float],
) -> State:
    """Return the state of the boat after one step of the classical Runge-Kutta method of fourth order.

    Parameters
    ----------
    rhs : Rhs
        Equations of motion: the function that `make_rhs` returns.
    s : State
        State at the start of the step.
    k1 : State
        Time derivative of the state at the start of the step.
    h : float
        Step [s].
    n : tuple of four floats
        Shaft speeds (normalised): left and right in the middle of the step, left and right at its end.
    energy : float
        Used energy in units of ENERGY_UNIT, constant in the step.
    forces : tuple of three floats
        External forces [N, N, N m], constant in the step.
    """
    # Written out, since loops and calls take twice as long.
    mid_l, mid_r, end_l, end_r = n
    x_force, y_force, moment = forces
    half, sixth = 0.5 * h, h / 6.0
    x, y, psi, u, v, r, angle, rate = s
    a1, b1, c1, d1, e1, f1, g1, i1 = k1
    between: State = (
        x + half * a1, y + half * b1, psi + half * c1, u + half * d1,
        v + half * e1, r + half * f1, angle + half * g1, rate + half * i1,
    )  # fmt: skip
    a2, b2, c2, d2, e2, f2, g2, i2 = rhs(between, mid_l, mid_r, energy, x_force, y_force, moment)
    between = (
        x + half * a2, y + half * b2, psi + half * c2, u + half * d2,
        v + half * e2, r + half * f2, angle + half * g2, rate + half * i2,
    )  # fmt: skip
    a3, b3, c3, d3, e3, f3, g3, i3 = rhs(between, mid_l, mid_r, energy, x_force, y_force, moment)
    end: State = (
        x + h * a3, y + h * b3, psi + h * c3, u + h * d3, v + h * e3, r + h * f3, angle + h * g3, rate + h * i3
    )  # fmt: skip
    a4, b4, c4, d4, e4, f4, g4, i4 = rhs(end, end_l, end_r, energy, x_force, y_force, moment)
    return (
        x + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        y + sixth * (b1 + 2.0 * (b2 + b3) + b4),
        psi + sixth * (c1 + 2.0 * (c2 + c3) + c4),
        u + sixth * (d1 + 2.0 * (d2 + d3) + d4),
        v + sixth * (e1 + 2.0 * (e2 + e3) + e4),
        r + sixth * (f1 + 2.0 * (f2 + f3) + f4),
        angle + sixth * (g1 + 2.0 * (g2 + g3) + g4),
        rate + sixth * (i1 + 2.0 * (i2 + i3) + i4),
    )
