"""Checks of frames of reference: are positions, velocities, heading and yaw rate in the same right-handed frame?

Theory of operation. Displacements D over windows of time are complex numbers, north + i east. A boat moves about in the
direction of its heading: D = s exp(i psi) with a real s. The imaginary part of D exp(-i psi), the displacement across
the heading, is then small. A heading that counts anticlockwise, or a track with mirrored axes, gives
D = s exp(-i psi). An offset of the heading turns the principal axis of D exp(-i psi) or D exp(i psi). A constant
current is estimated beside each hypothesis.

The misfit of a hypothesis is its squared error over the sum of squares of the signal. A hypothesis replaces that of a
correct log if three conditions hold:

1. Its misfit is smaller by at least ``LEAST_GAIN``.
2. Its misfit is at most ``MOST_LEFT`` of that of the correct log.
3. The t statistic of the gain per block of time is above ``SIGNIFICANT_T``. Blocks are nearly independent, but
   neighbouring windows are not.

For mock boats the share across the heading is 0.01 to 0.15; for their mirror images it is 0.35 to 0.5.

A mirror is a sign between two signals. All signs together show which signal is wrong (`mirrored_signals`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import Finding
from seatrial.ident.checks.sensors import SAME_UNIT, Channels, Match, common_grid, velocity_unit_fault
from seatrial.ident.numerics import Array, cumulative_integral, signed_rank_z

Complex = NDArray[np.complex128]
BLOCK_S = 10.0  # least duration of a block
FEWEST_BLOCKS, SIGNIFICANT_T = 6, 2.5
LEAST_GAIN, MOST_LEFT = 0.2, 0.6  # of the sum of squares; of the misfit of the correct log
LEAST_OFFSET, SAME_OFFSET = np.radians(45.0), np.radians(25.0)  # of a heading: a smaller one may be declination
GOOD, BAD = 0.3, 0.8  # misfit of an axis that agrees, and of an axis that is another signal
STILL = 0.02  # mean square displacement along an axis over that along the other one, each per share of the headings
SENSE_R2 = 0.3  # of heading and yaw rate; with less their relative sign is unknown
REVERSED_T = 6.0  # t statistic of a single sign that is reversed
# Change of velocity over what ax and ay would cause. A boat that heels outward in turns, or lifts its bow with the
# thrust, measures a part of gravity as a larger acceleration: no factor between usual units, 0.3 and less, is this near
INCLINED = (0.4, 0.6)
MIN_ACCELERATION_R2 = 0.3  # a calm run has less, and its scale is not compared
LEAST_SPEED = 0.1  # m/s (rms); slower tracks are not judged
# Errors of a pair of axes, as maps of north + i east (or forward + i starboard), with their texts for findings.
AXES: Mapping[str, Callable[[Complex], Complex]] = {
    "both signs are reversed": lambda z: -z,
    "the second sign is reversed": lambda z: np.conj(z),
    "the first sign is reversed": lambda z: -np.conj(z),
    "the two are exchanged": lambda z: 1j * np.conj(z),
    "the two are exchanged and both signs reversed": lambda z: -1j * np.conj(z),
    "turned by 90 deg": lambda z: 1j * z,
    "turned by -90 deg": lambda z: -1j * z,
}
MIRRORS = ("the second sign is reversed", "the first sign is reversed", "the two are exchanged",
           "the two are exchanged and both signs reversed")  # fmt: skip
TOGETHER = (("gyro", "heading"), ("position", "velocity"))  # signals of one device may be mirrored together
Relation = tuple[str, str]


class Course(NamedTuple):
    """Relation of a track to the heading.

    Attributes
    ----------
    parity
        +1 if the track turns with the heading, -1 for a mirror image, 0 if unknown.
    offset
        Angle [rad] of the track to the heading, modulo pi; 0 if it is at most 45 deg or not significant. For a mirror
        image it is the angle to the mirrored heading, without these limits.
    """

    parity: int
    offset: float


class HypothesisFit(NamedTuple):
    """Least-squares fit of one hypothesis about the axes of two signals.

    Attributes
    ----------
    scale
        Factor of the regressor, not negative.
    misfit
        Squared error over the sum of squares of the signal, 0 to 1.
    blocks
        Contributions (n_blocks,) to the misfit by consecutive intervals of at least 10 s (blocks); their sum is the
        misfit.
    """

    scale: float
    misfit: float
    blocks: Array


def check_frames(c: Channels, heading: Match | None, turning: Mapping[str, int]) -> Iterator[Finding]:
    """Yield a fault if heading, yaw rate, positions and velocities are not in the same frame.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    heading
        Relation of heading and yaw rate (`seatrial.ident.checks.sensors.heading_match`); None if unknown.
    turning
        Sign with which the ``gyro``, the ``heading`` and the course of the ``position`` follow the turning moment of
        the thrusters: +1, -1, or 0 if unknown.

    Yields
    ------
    Finding
        At most one fault: the first of a velocity over ground that is one in body axes, mirrored signals, exchanged
        axes, an axis without motion, an offset of the heading, and body velocities in a wrong frame.
    """
    tracks = {
        n: w
        for n, pair in (("position", ("x", "y")), ("velocity", ("vx", "vy")))
        if (w := displacement_windows(c, *pair))
    }
    if (body := _body_axes_of_velocity(c, tracks)) is not None:
        yield body
        return
    courses = {n: track_course(c, w) for n, w in tracks.items() if "psi" in c}
    signs: dict[Relation, int] = {(n, "heading"): found.parity for n, found in courses.items() if found is not None}
    signs |= {("thrusters", name): sign for name, sign in turning.items()}
    if heading is not None and heading.r2 > SENSE_R2:
        signs["heading", "gyro"] = int(np.sign(heading.scale))
    axes = _axes_error(tracks) if len(tracks) == 2 else None
    if len(tracks) == 2:
        signs["position", "velocity"] = -1 if axes in MIRRORS else 1
    wrong = mirrored_signals(signs)
    if wrong is not None and wrong != ("thrusters",):  # `seatrial.ident.checks.motion` checks each thruster
        yield _mirror_fault(wrong, courses)
        return
    if axes is not None:
        yield Finding(
            "fault",
            "position-and-velocity-axes",
            "frame",
            "x, y and vx, vy",
            f"velocities and positions have different axes; in vx, vy compared with x, y: {axes}",
            "correct columns and signs in the import map; x and vx are north, y and vy are east",
        )
        return
    for name, w in tracks.items():
        still = _motionless_axis(c, w) if "psi" in c else None
        if still is not None:
            where = "x, y" if name == "position" else "vx, vy"
            text = f"the boat heads in all directions, but the track hardly changes along the {still} axis"
            signal = where.split(", ")[still == "east"]
            advice = f"give another column for {signal} in the import map"
            yield Finding("fault", f"{name}-axes", "frame", where, text, advice)
            return
    offsets = [found.offset for found in courses.values() if found is not None]
    if offsets and all(offsets) and abs(np.exp(2j * offsets[0]) - np.exp(2j * offsets[-1])) < 2.0 * SAME_OFFSET:
        yield Finding(
            "fault",
            "heading-offset",
            "frame",
            "psi",
            f"the boat moves at {np.degrees(offsets[0]):.0f} deg (or 180 deg more) to its heading: the heading "
            "is not counted from north, or north and east are exchanged",
            "correct the offset of psi (clockwise from north), or the columns of x and y, in the import map",
        )
        return
    yield from _body_velocity_fault(c, tracks)


class Windows(NamedTuple):
    """Displacements of a track over windows of time.

    Attributes
    ----------
    t
        Centres of the windows (n,) [s].
    width
        Duration of each window [s].
    d
        Displacements (n,) [m] as complex numbers, north + i east.
    """

    t: Array
    width: float
    d: Complex


def _is_slow(d: Complex, width: float) -> bool:
    """Return whether displacements d (n,) [m] over windows of a ``width`` [s] are of a boat below 0.1 m/s (rms)."""
    return bool(np.sqrt(np.mean(np.abs(d) ** 2)) < LEAST_SPEED * width)


def displacement_windows(c: Channels, north: str, east: str) -> Windows | None:
    """Return displacements over windows of time, by positions or by integrated velocities.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    north, east
        Names of the channels: ``x``, ``y`` or ``vx``, ``vy``.

    Returns
    -------
    Windows or None
        Windows of 2 s, or of four sample intervals if these are longer. None if a channel is missing, or if the two
        channels overlap for less than 60 s (24 windows if these are longer).
    """
    if not {north, east} <= set(c):
        return None
    a, b = c[north], c[east]
    width = max(2.0, 4.0 * float(np.median(np.diff(a.t))))
    begin, end = max(a.t[0], b.t[0]), min(a.t[-1], b.t[-1])
    if end - begin < FEWEST_BLOCKS * max(BLOCK_S, 4.0 * width):
        return None
    edges = np.arange(begin, end, width)
    if north == "x":
        at = [np.interp(edges, s.t, s.value) for s in (a, b)]
    else:
        fine = np.linspace(begin, end, min(int((end - begin) / width) * 40, 400_000))
        at = [np.interp(edges, fine, cumulative_integral(fine, np.interp(fine, s.t, s.value))) for s in (a, b)]
    return Windows(edges[:-1] + width / 2, width, np.diff(at[0]) + 1j * np.diff(at[1]))


def track_course(c: Channels, w: Windows) -> Course | None:
    """Return the relation of a track to the heading.

    Parameters
    ----------
    c
        Channels (signals) of a log by name, with ``psi``.
    w
        Displacements of the track.

    Returns
    -------
    Course or None
        None if the boat moves at less than 0.1 m/s (rms), or if the heading covers fewer than 18 windows of the track.
    """
    psi = c["psi"]
    inside = (w.t > psi.t[0]) & (w.t < psi.t[-1])
    d, at = w.d[inside], w.t[inside]
    if d.size < 3 * FEWEST_BLOCKS or _is_slow(d, w.width):
        return None
    heading = np.interp(at, psi.t, np.unwrap(psi.value))
    block = _block_of_windows(at, w.width)
    whole = float(np.sum(np.abs(d) ** 2))
    current = np.column_stack([np.cos(heading), np.sin(heading)])
    across: dict[int, Array] = {}
    angle: dict[int, float] = {}
    along = {sense: _regression_residuals(current, d * np.exp(-1j * sense * heading)) for sense in (1, -1)}
    for sense, p in along.items():
        angle[sense] = 0.5 * float(np.angle(np.sum(p**2)))
        across[sense] = _sum_per_block(np.imag(p * np.exp(-1j * angle[sense])) ** 2, block) / whole
    as_logged = _sum_per_block(np.imag(along[1]) ** 2, block) / whole
    if _is_significantly_better(across[1], across[-1]):
        return Course(-1, angle[-1])
    turned = abs(angle[1]) > LEAST_OFFSET and _is_significantly_better(as_logged, across[1])
    return Course(int(_is_significantly_better(across[-1], across[1])), angle[1] if turned else 0.0)


def mirrored_signals(signs: Mapping[Relation, int]) -> tuple[str, ...] | None:
    """Return the signals that are mirrored.

    Parameters
    ----------
    signs
        For each pair of signals: +1 if they agree, -1 if one is the mirror image of the other, 0 if unknown. Signals
        are ``gyro``, ``heading``, ``position``, ``velocity`` and ``thrusters``.

    Returns
    -------
    tuple or None
        The signal, or the two signals of one device, whose mirroring explains all signs. If there are several
        explanations, all their signals; ``thrusters`` alone if they are one of them. If there is no explanation, all
        signals with a known sign. None if no known sign is negative. Several names are in alphabetical order.
    """
    known = {pair: sign for pair, sign in signs.items() if sign}
    if all(sign > 0 for sign in known.values()):
        return None
    related = sorted({name for pair in known for name in pair})

    def explains(mirrored: tuple[str, ...]) -> bool:
        """Return whether all known signs follow if exactly these signals are mirrored.

        The sign of a pair is negative if just one of its two signals is mirrored.
        """
        return all((sign < 0) == (len(set(pair) & set(mirrored)) == 1) for pair, sign in known.items())

    together = [names for names in TOGETHER if set(names) <= set(related)]
    found = [names for names in (*((n,) for n in related), *together) if explains(names)]
    if ("thrusters",) in found:
        return ("thrusters",)  # the most frequent cause if the signs leave a choice
    return found[0] if len(found) == 1 else tuple(sorted({n for names in found for n in names} or related))


def _change_sign(signals: str) -> str:
    """Return the advice to change the sign of some signals. The checks do not know whether the map has one already."""
    return f"change the sign of {signals} in the import map (sign = -1, or remove it if it is there)"


# Code, signals, text and advice of the finding for each signal that is mirrored.
MIRRORED = {
    "heading": ("heading-sense", "psi", "the heading counts anticlockwise",
                f"psi is clockwise from north; {_change_sign('psi')}"),
    "gyro": ("gyro-sign-reversed", "r", "the yaw rate has the opposite sign",
             f"r is positive clockwise, seen from above; {_change_sign('r')}, or correct the mounting"),
    "position": ("position-axes", "x, y", "the positions are mirrored",
                 "x is north, y is east; correct their columns or signs in the import map"),
    "velocity": ("velocity-axes", "vx, vy", "the velocities are mirrored",
                 "vx is north, vy is east; correct their columns or signs in the import map"),
    "gyro heading": ("heading-sense", "psi and r", "heading and yaw rate count anticlockwise",
                     f"psi and r are clockwise, seen from above; {_change_sign('both')}"),
    "position velocity": ("position-axes", "x, y, vx, vy", "positions and velocities are mirrored",
                          "x and vx are north, y and vy are east; correct their columns or signs in the import map"),
}  # fmt: skip


def _mirror_fault(names: tuple[str, ...], courses: Mapping[str, Course | None]) -> Finding:
    """Return the fault for mirrored signals.

    A signal, or two signals of one device, have a fault of their own (`MIRRORED`); for any other set of names it is
    ``frames-mirrored``, which does not state the wrong one. ``names``: the signals, or all signals of which some are
    mirrored (`mirrored_signals`). ``courses``: relation of each track to the heading, None if unknown. It shows whether
    the axes are exchanged or one sign is reversed.
    """
    offset = next((f.offset for f in courses.values() if f is not None and f.parity < 0), None)
    quarter = offset is not None and abs(abs(np.degrees(offset)) - 90.0) < 45.0  # a mirror that exchanges the axes
    entry = MIRRORED.get(" ".join(names))
    if entry is None:
        where = ", ".join(MIRRORED[n][1] if n in MIRRORED else n for n in names)
        text = "some of these signals are mirror images of the others; the log does not show which are wrong"
        text += "; north and east may be exchanged" if quarter else ""
        advice = (
            "check sign and column of each in the import map, and its frame (a bag of ROS usually has frame = "
            '"ENU"); axes are north and east, angles clockwise'
        )
        return Finding("fault", "frames-mirrored", "frame", where, text, advice)
    code, where, text, advice = entry
    if "heading" in names and quarter:
        text += ", from east"
        advice += ", and offset = -90 of psi (deg)"
    elif "heading" not in names and offset is not None:
        text += ": the two axes are exchanged" if quarter else ": one sign is reversed"
    return Finding("fault", code, "frame", where, text, advice)


def _motionless_axis(c: Channels, w: Windows) -> str | None:
    """Return the axis, ``north`` or ``east``, along which a track does not move although the boat heads there.

    ``c`` has the heading ``psi``. The result is None if the track moves along both axes (each mean square displacement
    per share of the headings is above 2 % of the other one), if the boat is slower than 0.1 m/s (rms), if its headings
    vary too little (a mean of cos^2 or sin^2 of the heading below 0.2), or if the heading covers fewer than 18 windows
    of the track.
    """
    psi = c["psi"]
    inside = (w.t > psi.t[0]) & (w.t < psi.t[-1])
    heading, d = np.interp(w.t[inside], psi.t, np.unwrap(psi.value)), w.d[inside]
    if d.size < 3 * FEWEST_BLOCKS or _is_slow(d, w.width):
        return None
    headed = np.array([np.mean(np.cos(heading) ** 2), np.mean(np.sin(heading) ** 2)])
    moved = np.array([np.mean(d.real**2), np.mean(d.imag**2)]) / np.maximum(headed, 1e-12)
    if headed.min() < LEAST_GAIN or moved.min() > STILL * moved.max():
        return None
    return ("north", "east")[int(np.argmin(moved))]


def half_turn(text: str) -> Finding:
    """Return the fault for a heading that is wrong by half a turn, or for two axes whose signs are both reversed.

    Parameters
    ----------
    text
        Text of the finding: the observation that shows the fault.

    Returns
    -------
    Finding
        Fault ``heading-half-turn`` of the signal ``psi``, with advice on the offset of psi and on the signs.
    """
    advice = f"set offset = 180 of psi (deg) in the import map, or {_change_sign('both axes of the reversed signals')}"
    return Finding("fault", "heading-half-turn", "frame", "psi", text, advice)


def _axes_error(tracks: Mapping[str, Windows]) -> str | None:
    """Return the error of the axes that explains why velocities and positions disagree, as a text for a finding.

    ``tracks``: displacements by ``position`` and by ``velocity``. The error is an exchange or reversal of the axes of
    the velocity (`AXES`), or one axis that is another column. The result is None if both agree or no error explains
    them, if the boat is slower than 0.1 m/s (rms), or if fewer than 18 windows overlap.
    """
    p, v = tracks["position"], tracks["velocity"]
    inside = (p.t > v.t[0]) & (p.t < v.t[-1])
    if inside.sum() < 3 * FEWEST_BLOCKS:
        return None
    rate = [np.interp(p.t[inside], v.t, f(v.d)) * (p.width / v.width) for f in (np.real, np.imag)]
    moved = rate[0] + 1j * rate[1]
    if _is_slow(moved, p.width):
        return None
    block = _block_of_windows(p.t[inside], p.width)
    candidates = {"": moved} | {name: of(moved) for name, of in AXES.items()}
    best = preferred_hypothesis({name: fit_hypothesis(p.d[inside], z, block, ()) for name, z in candidates.items()})
    if best is None:
        alone = [fit_hypothesis(f(p.d[inside]) + 0j, f(moved) + 0j, block, ()).misfit for f in (np.real, np.imag)]
        power = [float(np.sum(f(moved) ** 2)) for f in (np.real, np.imag)]
        for good, bad, name in ((0, 1, "y"), (1, 0, "x")):
            if alone[good] < GOOD < BAD < alone[bad] and power[bad] > LEAST_GAIN * power[good]:
                return f"{name} or v{name} is from a wrong column"
    return best


def _body_axes_of_velocity(c: Channels, tracks: Mapping[str, Windows]) -> Finding | None:
    """Return a fault if vx and vy agree with the positions only after they are turned by the heading; else None.

    They are then a velocity in body axes, as the twist of an odometry message in ROS. Wrong axes of a velocity over
    ground must explain the positions less well. ``tracks``: displacements by
    ``position`` and by ``velocity``. None also if positions, velocities or heading are missing or overlap for less than
    20 s or 18 windows of the positions, or if the boat is slower than 0.1 m/s (rms).
    """
    if len(tracks) < 2 or "psi" not in c:
        return None
    track = tracks["position"]
    if _is_slow(track.d, track.width):
        return None
    turned = _body_frame_comparison(c, "vx", "vy", track)
    if turned is None:
        return None
    d, block, moved, turn, w = turned
    candidates = {name: moved(of(w)) for name, of in AXES.items()} | {"": moved(w), "body": moved(turn * w)}
    candidates |= {f"body: {name}": moved(turn * of(w)) for name, of in AXES.items()}
    best = preferred_hypothesis({name: fit_hypothesis(d, z, block, ()) for name, z in candidates.items()})
    if best is None or not best.startswith("body"):
        return None
    return Finding(
        "fault",
        "velocity-body-fixed",
        "frame",
        "vx, vy",
        "the velocity is in body axes: it agrees with the positions if it is turned by the heading",
        "name its signals u (forward) and v (to starboard) in the import map; if v is to port in the source, give "
        'frame = "FLU"',
    )


def _body_velocity_fault(c: Channels, tracks: Mapping[str, Windows]) -> Iterator[Finding]:
    """Yield at most one fault if u and v are not m/s forward and to starboard, by comparison with track and heading.

    The track is that of the velocities over ground, else of the positions. There is no finding if u, v, heading or
    track is missing, if they overlap for less than 20 s or 18 windows of the track, or if the boat is slower than 0.1
    m/s (rms).
    """
    track = tracks.get("velocity") or tracks.get("position")
    if not {"u", "v", "psi"} <= set(c) or track is None:
        return
    if _is_slow(track.d, track.width):
        return
    turned = _body_frame_comparison(c, "u", "v", track)
    if turned is None:
        return
    d, block, moved, turn, w = turned
    candidates = {"": moved(turn * w), "earth": moved(w), "earth, exchanged": moved(1j * np.conj(w))}
    candidates |= {name: moved(turn * of(w)) for name, of in AXES.items()}
    candidates |= {f"track: {name}": AXES[name](candidates[""]) for name in MIRRORS}
    current = np.full(d.size, track.width + 0j)  # displacement by a current of 1 m/s north
    fits = {name: fit_hypothesis(d, z, block, (current, 1j * current)) for name, z in candidates.items()}
    best = preferred_hypothesis(fits)
    if best is None:
        forward, starboard = moved(turn * w.real), moved(1j * turn * w.imag)
        best = _reversed_column(d, block, (forward, starboard, current, 1j * current))
    if best is None:
        if fits[""].misfit < GOOD and not SAME_UNIT[0] < fits[""].scale < SAME_UNIT[1]:
            yield velocity_unit_fault("the track", "u and v", fits[""].scale, "u, v")
        return
    if best.startswith("earth"):
        text = "u and v are velocities north and east" + (", exchanged" if best != "earth" else "")
        yield Finding(
            "fault",
            "velocity-earth-fixed",
            "frame",
            "u, v",
            f"{text}: they agree with the track without being turned by the heading",
            "name them vx (north) and vy (east) in the import map",
        )
        return
    if best == "both signs are reversed":
        yield half_turn("u and v point opposite to the track")
        return
    if best.startswith("track: "):
        by, where = ("velocity", "vx, vy") if "velocity" in tracks else ("position", "x, y")
        text = f"the track does not agree with heading, u and v: in {where}, {best.removeprefix('track: ')}"
        advice = "correct columns and signs in the import map; the first is north, the second is east"
        yield Finding("fault", f"{by}-axes", "frame", where, text, advice)
        return
    yield Finding(
        "fault",
        "body-velocity-axes",
        "frame",
        "u, v",
        f"u and v do not agree with track and heading: {best}",
        "correct columns and signs in the import map; u is forward, v is to starboard",
    )


def check_accelerometer(c: Channels, found: Match | None) -> Iterator[Finding]:
    """Yield at most one fault if ax and ay are not forward and to starboard in m/s2, or one warning.

    The specific force, turned by the heading, is compared with the change of the velocity over ground. The warning is
    for accelerometers that seem to measure a part of gravity (`INCLINED`).

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    found
        Relation of velocity and specific force (`seatrial.ident.checks.sensors.velocity_match`). None gives no finding.
        There is also none if velocities, accelerometers and heading overlap for too short a time.
    """
    velocity = displacement_windows(c, "vx", "vy")
    if found is None or velocity is None:
        return
    north, east = c["vx"], c["vy"]
    ends = [velocity.t + s * velocity.width / 2 for s in (1, -1)]
    change = [np.interp(t, north.t, north.value) + 1j * np.interp(t, east.t, east.value) for t in ends]
    turned = _body_frame_comparison(c, "ax", "ay", velocity._replace(d=change[0] - change[1]))
    if turned is None:
        return
    d, block, moved, turn, w = turned
    bias = (moved(turn), moved(1j * turn))
    fits = {name: fit_hypothesis(d, moved(turn * of(w)), block, bias) for name, of in AXES.items()}
    fits[""] = fit_hypothesis(d, moved(turn * w), block, bias)
    best = preferred_hypothesis(fits) or _reversed_column(
        d, block, (moved(turn * w.real), moved(1j * turn * w.imag), *bias)
    )
    if best == "both signs are reversed":
        yield half_turn("ax and ay point opposite to the change of velocity")
    elif best is not None:
        yield Finding(
            "fault",
            "acceleration-axes",
            "frame",
            "ax, ay",
            f"ax and ay do not agree with the change of velocity: {best}",
            "correct columns and signs in the import map, or the mounting; ax is forward, ay is to starboard",
        )
    elif found.r2 > MIN_ACCELERATION_R2 and INCLINED[0] < found.scale < INCLINED[1]:
        yield Finding(
            "warning",
            "acceleration-larger-than-motion",
            "units",
            "ax, ay",
            f"the velocity changes only {found.scale:.2f} times as much as ax and ay would cause: does the boat heel "
            "in turns, or pitch with the thrust?",
            "if it does, seatrial ident diagnose can find how much (the effect accelerometer-tilt); if not, check "
            "the units",
        )
    elif found.r2 > MIN_ACCELERATION_R2 and not INCLINED[1] <= found.scale < 1.6:
        unit = "are these in g?" if abs(found.scale / 9.81 - 1.0) < 0.25 else "wrong unit, or wrong axes?"
        yield Finding(
            "fault",
            "velocity-and-acceleration-scale",
            "units",
            "ax, ay",
            f"the velocity changes {found.scale:.2f} times as much as ax and ay would cause: {unit}",
            'correct the unit of ax and ay (unit = "g"), or of the velocity (knots, km/h), in the import map',
        )


Turned = tuple[Complex, NDArray[np.intp], Callable[[Complex], Complex], Complex, Complex]


def _body_frame_comparison(c: Channels, forward: str, starboard: str, track: Windows) -> Turned | None:
    """Prepare the comparison of two channels of the body frame with a track.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    forward, starboard
        Names of the channels: ``u``, ``v`` or ``ax``, ``ay``.
    track
        Displacements or changes of velocity to compare with.

    Returns
    -------
    tuple or None
        Five elements. The displacements in the windows that the channels cover (n,). The number of the block of time of
        each window (n,), from 0. A function that integrates a signal of the common grid over each window (n,). The
        rotation exp(i psi) from body to NED frame, and the channels as forward + i starboard, both on that grid. None
        if the channels and the heading overlap for less than 20 s, or cover fewer than 18 windows of the track.
    """
    t = common_grid(c[forward], c[starboard], c["psi"])
    if t.size < 400:
        return None
    inside = (track.t - track.width / 2 > t[0]) & (track.t + track.width / 2 < t[-1])
    at = track.t[inside]
    if at.size < 3 * FEWEST_BLOCKS:
        return None

    def moved(rate: Complex) -> Complex:
        """Return the integral (n,) of a signal over each of the n windows of the track that lie inside the common grid.

        The common grid ``t`` covers the time in which both channels and the heading have samples. ``rate`` has a value
        at each time of the grid: a velocity or an acceleration in a horizontal plane, as a complex number such as north
        + i east. The integral is then the displacement, or the change of velocity, from the start to the end of each
        window.
        """
        integral = cumulative_integral(t, rate)
        ends = [np.interp(at + s * track.width / 2, t, integral) for s in (1, -1)]
        return np.asarray(ends[0] - ends[1])

    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
    w = np.interp(t, c[forward].t, c[forward].value) + 1j * np.interp(t, c[starboard].t, c[starboard].value)
    return track.d[inside], _block_of_windows(at, track.width), moved, np.exp(1j * psi), w


def _reversed_column(target: Complex, block: NDArray[np.intp], columns: tuple[Complex, ...]) -> str | None:
    """Return which of the first two columns has the wrong sign in a regression of the target (n,) on all columns.

    The factor of that column must be -2 to -0.5 and significantly negative (t below -6, with a standard error that is
    robust to correlation within blocks). The result is ``the first sign is reversed`` or ``the second sign is
    reversed``. If both factors are so, it is the first sign. It is None if neither factor is so, or if the values are
    too large for a regression. The columns have the shape (n,). ``block`` (n,): number of the block of time of each
    sample, from 0.
    """
    X = np.column_stack([np.concatenate([z.real, z.imag]) for z in columns])
    y = np.concatenate([target.real, target.imag])
    with np.errstate(over="ignore", invalid="ignore"):
        squares = X.T @ X
    if not np.isfinite(squares).all():  # with infinite entries the singular value decomposition may never end
        return None
    inverse = np.linalg.pinv(squares)
    beta = inverse @ X.T @ y
    scores = X * (y - X @ beta)[:, None]
    per_block = np.column_stack([_sum_per_block(s[: target.size] + s[target.size :], block) for s in scores.T])
    error = np.sqrt(np.diag(inverse @ per_block.T @ per_block @ inverse))
    for k, name in enumerate(("the first sign is reversed", "the second sign is reversed")):
        if -2.0 < beta[k] < -0.5 and beta[k] < -REVERSED_T * error[k]:
            return name
    return None


def fit_hypothesis(target: Complex, z: Complex, block: NDArray[np.intp], others: tuple[Complex, ...]) -> HypothesisFit:
    """Fit a measured signal by the signal that a hypothesis about the axes predicts, by least squares.

    Parameters
    ----------
    target
        Displacements or changes of velocity (n,), north + i east.
    z
        The same quantity as the hypothesis predicts it (n,). Its factor is real and not negative.
    block
        Number of the block of time of each sample (n,), from 0.
    others
        Further regressors (n,) with any real factors, for example a constant current. They are projected out first, and
        the misfit refers to what remains of the target.
    """
    Y, Z = (np.concatenate([s.real, s.imag]) for s in (target, z))
    if others:
        X = np.column_stack([np.concatenate([o.real, o.imag]) for o in others])
        Y, Z = _regression_residuals(X, Y), _regression_residuals(X, Z)
    scale = max(float(Z @ Y) / max(float(Z @ Z), 1e-300), 0.0)
    e = (Y - scale * Z) ** 2
    per_block = _sum_per_block(e[: target.size] + e[target.size :], block) / max(float(Y @ Y), 1e-300)
    return HypothesisFit(scale, float(per_block.sum()), per_block)


def preferred_hypothesis(found: Mapping[str, HypothesisFit]) -> str | None:
    """Return the name of the best hypothesis about a wrong frame.

    Parameters
    ----------
    found
        Fit of each hypothesis by its name. The entry "" is the hypothesis that the log is correct.

    Returns
    -------
    str or None
        None if the hypothesis with the least misfit is "", or is not significantly better than ""
        (`_is_significantly_better`). Another hypothesis that is significantly better than "" is then not returned.
    """
    best = min(found, key=lambda name: found[name].misfit)
    return best if best and _is_significantly_better(found[""].blocks, found[best].blocks) else None


def _is_significantly_better(old: Array, new: Array) -> bool:
    """Return whether the new hypothesis fits significantly better than the old one.

    ``old``, ``new``: contributions (n_blocks,) of the blocks of time to the misfit of each hypothesis (0 to 1). The new
    misfit must be smaller by at least 0.2 and at most 0.6 of the old one. Either the t statistic of the gain per block
    must exceed 2.5, or the statistic of the signed ranks of the gains. The result is false for fewer than 6 blocks.
    """
    gain = old - new
    total = float(gain.sum())
    if gain.size < FEWEST_BLOCKS or total < LEAST_GAIN or new.sum() > MOST_LEFT * old.sum():
        return False
    # A boat that covers most of its way in a few fast blocks has gains that differ too much for a t statistic.
    t = total / max(float(np.std(gain, ddof=1) * np.sqrt(gain.size)), 1e-300)
    return max(t, signed_rank_z(gain)) > SIGNIFICANT_T


def _block_of_windows(t: Array, width: float) -> NDArray[np.intp]:
    """Return the number (n,), from 0, of the block of time that contains each window at t (n,) [s].

    A block lasts at least 10 s and four windows of the given ``width`` [s].
    """
    return np.asarray((t - t[0]) // max(BLOCK_S, 4.0 * width), np.intp)


def _sum_per_block(values: Array, block: NDArray[np.intp]) -> Array:
    """Return the sums (n_blocks,) of values (n,) over each block; ``block`` (n,): number of the block, from 0."""
    return np.asarray(np.bincount(block, values), float)


def _regression_residuals(columns: Array, values: NDArray[Any]) -> NDArray[Any]:
    """Return the residuals (n,) of the linear regression of values (n,) on columns (n, k), without a constant."""
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0])
