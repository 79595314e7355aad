"""Checks of a mission before it is run: limits of the rig, duration, and whether its track stays inside the fence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from seatrial.bench.execution import missing_link_tests
from seatrial.bench.mission_limits import dry_run
from seatrial.daq.checks import FAULT, OK, WARNING, Finding
from seatrial.daq.config import Mission
from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig

FloatArray = npt.NDArray[np.float64]
TRACK_STEP_S = 0.05  # s, of the simulated track
MASSES = ("m_u", "m_v", "m_r")
NEEDED = (*MASSES, "d_u", "d_v", "d_r", "c1")  # parameters of [vehicle] that a simulated track needs
CLOSE = 0.8  # fraction of the fence's radius beyond which a track is near the fence


def check_mission(mission: Mission, rig: Rig) -> Iterator[Finding]:
    """Yield the findings on a mission that is to be run with a rig. No thruster is commanded.

    The first finding is whether its commands are within `limits.n_max` of the rig. If they are not, or if the rig lacks
    a thruster of the mission, there is this fault only. The second finding is whether its predicted track stays inside
    the geofence. It is left out if the rig has no `limits.radius_m`. A warning follows for each autopilot that needs a
    link test before this mission, and has none.
    """
    try:
        dry_run(mission, rig)
    except SeatrialError as error:
        yield Finding(FAULT, "mission-beyond-limits", "limits", mission.name, str(error))
        return
    largest = float(np.abs(mission.setpoints()[1]).max())
    yield Finding(
        OK,
        "mission-within-limits",
        "limits",
        mission.name,
        f"{mission.end:g} s, n up to {largest:.2f}, limit {rig.limits.n_max:g}",
    )
    if rig.limits.radius_m is not None:
        yield _fence_finding(mission, rig, rig.limits.radius_m)
    for name, why, advice in missing_link_tests(rig, mission.thrusters, largest):
        yield Finding(WARNING, "link-not-tested", "link", name, f"the run will be refused: {why}", advice)


def _fence_finding(mission: Mission, rig: Rig, radius: float) -> Finding:
    """Return the finding whether the predicted track of a mission stays within ``radius`` [m] of the start (geofence).

    The finding is a fault if the track leaves the fence. The finding is a warning if the track goes beyond 80 % of the
    radius, or cannot be predicted. Else it is OK. The track is that of the mission's design, with its 95 % band.
    Without a design it is simulated with the rig's nominal vehicle.
    """
    if mission.prediction is not None:
        p = mission.prediction
        t, far = p.t, np.hypot(p.x - p.x[0], p.y - p.y[0]) + p.radius
        by = f"the design, by model {p.model}"
    elif missing := [name for name in NEEDED if name not in rig.vehicle]:
        hint = "add them (c1: thrust of one thruster at full speed, in N), or use a designed mission"
        return _unpredicted_finding(mission, f"has no {', '.join(missing)}", hint)
    elif wrong := [name for name in MASSES if not rig.vehicle[name] > 0.0]:
        return _unpredicted_finding(
            mission, f"has {' and '.join(wrong)} not above zero", "write the masses of the boat into [vehicle]"
        )
    else:
        t, x, y = track(mission, rig)
        if not np.isfinite([x, y]).all():
            return _unpredicted_finding(
                mission, "makes it diverge", "write masses and damping of one boat into [vehicle]"
            )
        far, by = np.hypot(x, y), "the rig's nominal vehicle without current"
    k = int(np.argmax(far))
    text = f"up to {far[k]:.0f} m from the start by {by}, fence {radius:g} m"
    if far[k] > radius:
        left = float(t[int(np.flatnonzero(far > radius)[0])])
        return Finding(
            FAULT,
            "track-leaves-fence",
            "fence",
            mission.name,
            f"{text}, left after {left:.0f} s",
            "make the mission shorter or slower, or raise limits.radius_m if there is room",
        )
    if far[k] > CLOSE * radius:
        return Finding(
            WARNING,
            "track-near-fence",
            "fence",
            mission.name,
            text,
            "wind and current may carry the boat further: watch it, or make the mission shorter",
        )
    return Finding(OK, "track-inside-fence", "fence", mission.name, text)


def _unpredicted_finding(mission: Mission, why: str, hint: str) -> Finding:
    """Return the warning that the track of a mission could not be predicted, so that the geofence was not checked.

    ``why`` completes the sentence "[vehicle] of the rig ...", and ``hint`` is the remedy.
    """
    text = f"the track of this mission is not predicted: [vehicle] of the rig {why}"
    return Finding(WARNING, "track-not-predicted", "fence", mission.name, text, hint)


def track(mission: Mission, rig: Rig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Simulate the track of a mission with the rig's nominal vehicle, from rest, heading north, without current.

    Parameters
    ----------
    mission : Mission
        Mission whose commands are simulated.
    rig : Rig
        The rig. Its [vehicle] must have masses, linear damping and c1 (`NEEDED`, SI units); quadratic damping and c2
        are 0 if they are missing. The thrusters of the mission must be in the rig; their positions give the yaw moment.

    Returns
    -------
    tuple of Array (n_samples,)
        Time [s], 0.05 s apart, and position x, y [m] north and east of the start. Positions are NaN after a divergence.

    Raises
    ------
    KeyError
        If [vehicle] lacks a needed parameter.
    SeatrialError
        If the rig lacks a thruster of the mission.

    Notes
    -----
    Model of surge, sway and yaw (Fossen 2011, 6.5) with linear and quadratic damping. The thrust is c1 n|n| + c2 n^2,
    forward along the boat, without lag or delay.
    """
    p = {"c2": 0.0, "d_uu": 0.0, "d_vv": 0.0, "d_rr": 0.0, **rig.vehicle}
    y_thruster = [rig.thruster(name).position_m[1] for name in mission.thrusters]
    t_cmd, n_cmd = mission.setpoints()
    t = np.arange(0.0, mission.end + TRACK_STEP_S, TRACK_STEP_S)
    n = n_cmd[np.clip(np.searchsorted(t_cmd, t, side="right") - 1, 0, None)] * (t >= t_cmd[0])[:, None]
    f = p["c1"] * n * np.abs(n) + p["c2"] * n * n
    forces, moments = f.sum(axis=1).tolist(), (-f @ np.array(y_thruster)).tolist()
    state: tuple[float, ...] = (0.0,) * 6
    rows = []
    for thrust, moment in zip(forces, moments, strict=True):
        rows.append(state[:2])
        state = _next_state(state, thrust, moment, p)
    places = np.array(rows)
    return t, places[:, 0], places[:, 1]


def _next_state(state: tuple[float, ...], thrust: float, moment: float, p: Mapping[str, float]) -> tuple[float, ...]:
    """Return the state of a simulated boat after one time step of 0.05 s.

    The new velocities, along the new heading, move the position.

    Parameters
    ----------
    state : tuple of six floats
        State before the step: position x north and y east [m], heading psi [rad], surge u and sway v [m/s], and yaw
        rate r [rad/s].
    thrust : float
        Surge force of all thrusters [N].
    moment : float
        Yaw moment of all thrusters [N m].
    p : mapping of str to float
        Parameters of [vehicle] in the rig, with linear and quadratic damping (SI units).

    Returns
    -------
    tuple of six floats
        The new state; six times NaN if the new heading is not finite (the simulation has diverged).
    """
    x, y, psi, u, v, r = state
    u_next = _next_velocity(u, thrust + p["m_v"] * v * r, p["m_u"], p["d_u"], p["d_uu"])
    v_next = _next_velocity(v, -p["m_u"] * u * r, p["m_v"], p["d_v"], p["d_vv"])
    r_next = _next_velocity(r, moment - (p["m_v"] - p["m_u"]) * u * v, p["m_r"], p["d_r"], p["d_rr"])
    psi += TRACK_STEP_S * r_next
    if not math.isfinite(psi):
        return (math.nan,) * 6
    c, s = math.cos(psi), math.sin(psi)
    return (
        x + TRACK_STEP_S * (c * u_next - s * v_next),
        y + TRACK_STEP_S * (s * u_next + c * v_next),
        psi,
        u_next,
        v_next,
        r_next,
    )


def _next_velocity(speed: float, force: float, mass: float, d: float, dd: float) -> float:
    """Return the velocity of a boat in one degree of freedom after one time step of 0.05 s.

    The step uses the linearly implicit Euler method, which is stable for any damping, even if the boat is very light.

    Parameters
    ----------
    speed : float
        Velocity before the step [m/s or rad/s].
    force : float
        Force or moment on the boat, without that of the damping [N or N m].
    mass : float
        Mass or moment of inertia, with added mass [kg or kg m2].
    d, dd : float
        Linear and quadratic damping [SI units].
    """
    slope = max(d + 2.0 * dd * abs(speed), 0.0)
    return speed + TRACK_STEP_S * (force - (d + dd * abs(speed)) * speed) / (mass + TRACK_STEP_S * slope)
