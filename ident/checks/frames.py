"""Frames of reference: positions, velocities, heading and yaw rate in one and the same right-handed frame, or not.

Tracks are complex numbers, north + i east. Over a window a boat moves about as it is headed, D = exp(i psi) s with s
real: of D exp(-i psi) little is across. A heading that counts the other way, or a track with mirrored axes, obeys
D = exp(-i psi) s; an offset of the heading turns the principal axis of D exp(-+i psi). A constant current is left free.
Each hypothesis is judged by its squared misfit as a part of the whole; another one is preferred to what the log says
only where it is better by ``LEAST_GAIN`` of the whole, leaves at most ``MOST_LEFT`` of the misfit, and its gain per
block of time has a t statistic above ``SIGNIFICANT_T`` (blocks are nearly independent where neighbouring windows are
not). Of mock boats the across part is 0.01 to 0.15, of their mirrors 0.35 to 0.5.

A mirror is one sign between two signals; which of them is wrong follows from all signs together (``culprit``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import Finding
from seatrial.ident.checks.sensors import Channels, Match, cumulative, grid
from seatrial.ident.numerics import Array

Complex = NDArray[np.complex128]
BLOCK = 10.0  # s, at least
FEWEST_BLOCKS, SIGNIFICANT_T = 6, 2.5
LEAST_GAIN, MOST_LEFT = 0.2, 0.6  # of the whole squared signal; of the misfit of what the log says
LEAST_OFFSET, SAME_OFFSET = np.radians(45.0), np.radians(25.0)  # of a heading: less may be declination
GOOD, BAD = 0.3, 0.8  # misfit of one axis, and of the other one that is no axis at all
STILL = 0.02  # mean square of the displacement along an axis, by what is headed along it, against the other axis
SENSE_R2 = 0.3  # of heading and yaw rate, from which one has the sign of the other
REVERSED_T = 6.0  # t statistic of the one sign of two that is reversed
MIN_ACCELERATION_R2 = 0.3  # in a calm run there is nothing to compare
LEAST_SPEED = 0.1  # m/s (rms), below which nothing is said
# What may have been made of north + i east (or of ahead + i to starboard), and how to say it.
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
TOGETHER = (("gyro", "heading"), ("position", "velocity"))  # of one device, mirrored together
Relation = tuple[str, str]


class Course(NamedTuple):
    """A track against the heading: ``parity`` +1 or -1 (0: not known), and the angle ``offset`` [rad] at which it runs
    to the heading, up to half a turn; 0 where none is sure."""

    parity: int
    offset: float


class Fit(NamedTuple):
    """A hypothesis: ``scale`` of its regressor, squared misfit as a part of the whole, and per block."""

    scale: float
    misfit: float
    blocks: Array


def check_frames(c: Channels, heading: Match | None, turning: Mapping[str, int]) -> Iterator[Finding]:
    """Whether heading, yaw rate, positions and velocities are in one frame.

    Parameters: c: the channels; heading: how it follows the yaw rate (``sensors.heading_match``); turning: whether the
    ``gyro``, the ``heading`` and the course of the ``position`` turn as the thrusters push: +1, -1, 0 where it is not
    known.
    """
    tracks = {n: w for n, pair in (("position", ("x", "y")), ("velocity", ("vx", "vy"))) if (w := windows(c, *pair))}
    courses = {n: course(c, w) for n, w in tracks.items() if "psi" in c}
    signs: dict[Relation, int] = {(n, "heading"): found.parity for n, found in courses.items() if found is not None}
    signs |= {("thrusters", name): sign for name, sign in turning.items()}
    if heading is not None and heading.r2 > SENSE_R2:
        signs["heading", "gyro"] = int(np.sign(heading.scale))
    axes = _axes(tracks) if len(tracks) == 2 else None
    if len(tracks) == 2:
        signs["position", "velocity"] = -1 if axes in MIRRORS else 1
    wrong = culprit(signs)
    if wrong is not None and wrong != ("thrusters",):  # those are asked one by one (motion)
        yield _mirrored(wrong, courses)
        return
    if axes is not None:
        yield Finding(
            "fault",
            "position-and-velocity-axes",
            "frame",
            "x, y and vx, vy",
            f"positions and velocities have different axes: {axes} (of vx, vy)",
            "x and vx are north, y and vy east: column and sign in the import's map",
        )
        return
    for name, w in tracks.items():
        still = _still(c, w) if "psi" in c else None
        if still is not None:
            where = "x, y" if name == "position" else "vx, vy"
            text = f"the boat's track hardly goes {still}, whatever its heading"
            advice = "another column for that axis, in the import's map"
            yield Finding("fault", f"{name}-axes", "frame", where, text, advice)
            return
    offsets = [found.offset for found in courses.values() if found is not None]
    if offsets and all(offsets) and abs(np.exp(2j * offsets[0]) - np.exp(2j * offsets[-1])) < 2.0 * SAME_OFFSET:
        yield Finding(
            "fault",
            "heading-offset",
            "frame",
            "psi",
            f"the boat moves at {np.degrees(offsets[0]):.0f} deg to its heading (or half a turn more): the heading "
            "counts from another axis, or north and east are exchanged",
            "heading from north, clockwise: offset in the import's map, or the columns of x and y",
        )
        return
    yield from _body_velocity(c, tracks)


class Windows(NamedTuple):
    """Displacements ``d`` (n,) [m], north + i east, over windows of ``width`` [s] centred at ``t`` (n,) [s]."""

    t: Array
    width: float
    d: Complex


def windows(c: Channels, north: str, east: str) -> Windows | None:
    """Displacements by positions, or by velocities integrated; None where they are not there or too few."""
    if not {north, east} <= set(c):
        return None
    a, b = c[north], c[east]
    width = max(2.0, 4.0 * float(np.median(np.diff(a.t))))
    begin, end = max(a.t[0], b.t[0]), min(a.t[-1], b.t[-1])
    if end - begin < FEWEST_BLOCKS * max(BLOCK, 4.0 * width):
        return None
    edges = np.arange(begin, end, width)
    if north == "x":
        at = [np.interp(edges, s.t, s.value) for s in (a, b)]
    else:
        fine = np.linspace(begin, end, min(int((end - begin) / width) * 40, 400_000))
        at = [np.interp(edges, fine, cumulative(fine, np.interp(fine, s.t, s.value))) for s in (a, b)]
    return Windows(edges[:-1] + width / 2, width, np.diff(at[0]) + 1j * np.diff(at[1]))


def course(c: Channels, w: Windows) -> Course | None:
    """A track against the heading; None where the boat hardly moves or the times do not overlap."""
    psi = c["psi"]
    inside = (w.t > psi.t[0]) & (w.t < psi.t[-1])
    d, at = w.d[inside], w.t[inside]
    if d.size < 3 * FEWEST_BLOCKS or np.sqrt(np.mean(np.abs(d) ** 2)) < LEAST_SPEED * w.width:
        return None
    heading = np.interp(at, psi.t, np.unwrap(psi.value))
    block = _blocks(at, w.width)
    whole = float(np.sum(np.abs(d) ** 2))
    current = np.column_stack([np.cos(heading), np.sin(heading)])
    across: dict[int, Array] = {}
    angle: dict[int, float] = {}
    along = {sense: _without(current, d * np.exp(-1j * sense * heading)) for sense in (1, -1)}
    for sense, p in along.items():
        angle[sense] = 0.5 * float(np.angle(np.sum(p**2)))
        across[sense] = _per_block(np.imag(p * np.exp(-1j * angle[sense])) ** 2, block) / whole
    as_logged = _per_block(np.imag(along[1]) ** 2, block) / whole
    if _prefers(across[1], across[-1]):
        return Course(-1, angle[-1])
    turned = abs(angle[1]) > LEAST_OFFSET and _prefers(as_logged, across[1])
    return Course(int(_prefers(across[-1], across[1])), angle[1] if turned else 0.0)


def culprit(signs: Mapping[Relation, int]) -> tuple[str, ...] | None:
    """Which signals are mirrored against the others.

    Parameters: signs: by pair of signals, +1 where they agree in sense, -1 where one is the mirror of the other, 0
    where it is not known.
    Returns: the one signal, or the two of one device, whose mirror explains every sign; where several explain them,
    all of these; None where nothing is mirrored.
    """
    known = {pair: sign for pair, sign in signs.items() if sign}
    if all(sign > 0 for sign in known.values()):
        return None
    there = sorted({name for pair in known for name in pair})

    def explains(mirrored: tuple[str, ...]) -> bool:
        return all((sign < 0) == (len(set(pair) & set(mirrored)) == 1) for pair, sign in known.items())

    together = [names for names in TOGETHER if set(names) <= set(there)]
    found = [names for names in (*((n,) for n in there), *together) if explains(names)]
    if ("thrusters",) in found:
        return ("thrusters",)  # what happens most, where nothing tells
    return found[0] if len(found) == 1 else tuple(sorted({n for names in found for n in names} or there))


SAID = {
    "heading": ("heading-sense", "psi", "the heading counts the other way round",
                "clockwise from north: sign = -1 of psi in the import's map"),
    "gyro": ("gyro-sign-reversed", "r", "the yaw rate has the opposite sign",
             "positive clockwise, seen from above: sign = -1 of r in the import's map, or the mounting"),
    "position": ("position-axes", "x, y", "the positions are mirrored",
                 "x is north, y east: column and sign in the import's map"),
    "velocity": ("velocity-axes", "vx, vy", "the velocities are mirrored",
                 "vx is north, vy east: column and sign in the import's map"),
    "gyro heading": ("heading-sense", "psi and r", "heading and yaw rate count the other way round than all else",
                     "clockwise from north, seen from above: sign = -1 of both in the import's map"),
    "position velocity": ("position-axes", "x, y, vx, vy", "positions and velocities are mirrored",
                          "x and vx are north, y and vy east: column and sign in the import's map"),
}  # fmt: skip


def _mirrored(names: tuple[str, ...], courses: Mapping[str, Course | None]) -> Finding:
    offset = next((f.offset for f in courses.values() if f is not None and f.parity < 0), None)
    quarter = offset is not None and abs(abs(np.degrees(offset)) - 90.0) < 45.0
    known = SAID.get(" ".join(names))
    if known is None:
        where = ", ".join(SAID[n][1] if n in SAID else n for n in names)
        text = "mirror images of each other, and nothing in the log tells which is right"
        text += "; north and east may be exchanged" if quarter else ""
        advice = "north, east, clockwise: sign and columns in the import's map"
        return Finding("fault", "frames-mirrored", "frame", where, text, advice)
    code, where, text, advice = known
    if "heading" in names and quarter:
        text += ", from east"
        advice += ", and offset = -90 of psi (deg)"
    elif "heading" not in names and offset is not None:
        text += ": the two axes are exchanged" if quarter else ": one sign is reversed"
    return Finding("fault", code, "frame", where, text, advice)


def _still(c: Channels, w: Windows) -> str | None:
    """The axis, north or east, along which a track does not go although the heading does; None without one."""
    psi = c["psi"]
    inside = (w.t > psi.t[0]) & (w.t < psi.t[-1])
    heading, d = np.interp(w.t[inside], psi.t, np.unwrap(psi.value)), w.d[inside]
    if d.size < 3 * FEWEST_BLOCKS or np.sqrt(np.mean(np.abs(d) ** 2)) < LEAST_SPEED * w.width:
        return None
    headed = np.array([np.mean(np.cos(heading) ** 2), np.mean(np.sin(heading) ** 2)])
    moved = np.array([np.mean(d.real**2), np.mean(d.imag**2)]) / np.maximum(headed, 1e-12)
    if headed.min() < LEAST_GAIN or moved.min() > STILL * moved.max():
        return None
    return ("north", "east")[int(np.argmin(moved))]


def half_turn(text: str) -> Finding:
    """A heading, or both axes of a track, with the opposite sign."""
    advice = "offset = 180 of psi (deg), or sign = -1 of both axes of track, u and v, or ax and ay, in the import's map"
    return Finding("fault", "heading-half-turn", "frame", "psi", text, advice)


def _axes(tracks: Mapping[str, Windows]) -> str | None:
    """What would make the positions' track of the velocities', where it is not what they are."""
    p, v = tracks["position"], tracks["velocity"]
    inside = (p.t > v.t[0]) & (p.t < v.t[-1])
    if inside.sum() < 3 * FEWEST_BLOCKS:
        return None
    rate = [np.interp(p.t[inside], v.t, f(v.d)) * (p.width / v.width) for f in (np.real, np.imag)]
    moved = rate[0] + 1j * rate[1]
    if np.sqrt(np.mean(np.abs(moved) ** 2)) < LEAST_SPEED * p.width:
        return None
    block = _blocks(p.t[inside], p.width)
    candidates = {"": moved} | {name: of(moved) for name, of in AXES.items()}
    best = preferred({name: regress(p.d[inside], z, block, ()) for name, z in candidates.items()})
    if best is None:
        alone = [regress(f(p.d[inside]) + 0j, f(moved) + 0j, block, ()).misfit for f in (np.real, np.imag)]
        power = [float(np.sum(f(moved) ** 2)) for f in (np.real, np.imag)]
        for one, other, name in ((0, 1, "y"), (1, 0, "x")):
            if alone[one] < GOOD < BAD < alone[other] and power[other] > LEAST_GAIN * power[one]:
                return f"{name} or v{name} is another column"
    return best


def _body_velocity(c: Channels, tracks: Mapping[str, Windows]) -> Iterator[Finding]:
    """Whether u and v are ahead and to starboard: displacements by u, v and heading against the track's."""
    there = tracks.get("velocity") or tracks.get("position")
    if not {"u", "v", "psi"} <= set(c) or there is None:
        return
    if np.sqrt(np.mean(np.abs(there.d) ** 2)) < LEAST_SPEED * there.width:
        return
    turned = _turned(c, "u", "v", there)
    if turned is None:
        return
    d, block, moved, turn, w = turned
    candidates = {"": moved(turn * w), "earth": moved(w), "earth, exchanged": moved(1j * np.conj(w))}
    candidates |= {name: moved(turn * of(w)) for name, of in AXES.items()}
    still = np.full(d.size, there.width + 0j)
    best = preferred({name: regress(d, z, block, (still, 1j * still)) for name, z in candidates.items()})
    if best is None:
        ahead, aside = moved(turn * w.real), moved(1j * turn * w.imag)
        best = _reversed(d, block, (ahead, aside, still, 1j * still))
    if best is None:
        return
    if best.startswith("earth"):
        text = "u and v are velocities north and east" + (", exchanged" if best != "earth" else "")
        yield Finding(
            "fault",
            "velocity-earth-fixed",
            "frame",
            "u, v",
            f"{text}: they agree with the track without the heading",
            "name them vx (north) and vy (east) in the import's map",
        )
        return
    if best == "both signs are reversed":
        yield half_turn("u, v and the track are half a turn apart")
        return
    yield Finding(
        "fault",
        "body-velocity-axes",
        "frame",
        "u, v",
        f"u and v do not agree with track and heading: {best}",
        "u is ahead, v to starboard: column and sign in the import's map",
    )


def check_accelerometer(c: Channels, found: Match | None) -> Iterator[Finding]:
    """Whether ax and ay are ahead and to starboard, in m/s2: specific force turned by the heading against the change of
    the velocity over ground; ``found``: how that follows (``sensors.velocity_match``)."""
    velocity = windows(c, "vx", "vy")
    if found is None or velocity is None:
        return
    north, east = c["vx"], c["vy"]
    ends = [velocity.t + s * velocity.width / 2 for s in (1, -1)]
    change = [np.interp(t, north.t, north.value) + 1j * np.interp(t, east.t, east.value) for t in ends]
    turned = _turned(c, "ax", "ay", velocity._replace(d=change[0] - change[1]))
    if turned is None:
        return
    d, block, moved, turn, w = turned
    bias = (moved(turn), moved(1j * turn))
    fits = {name: regress(d, moved(turn * of(w)), block, bias) for name, of in AXES.items()}
    fits[""] = regress(d, moved(turn * w), block, bias)
    best = preferred(fits) or _reversed(d, block, (moved(turn * w.real), moved(1j * turn * w.imag), *bias))
    if best == "both signs are reversed":
        yield half_turn("ax and ay are half a turn from the change of velocity")
    elif best is not None:
        yield Finding(
            "fault",
            "acceleration-axes",
            "frame",
            "ax, ay",
            f"ax and ay do not agree with the change of velocity: {best}",
            "ax is ahead, ay to starboard: column and sign in the import's map, or the mounting",
        )
    elif found.r2 > MIN_ACCELERATION_R2 and not 0.6 < found.scale < 1.6:
        unit = "in g?" if abs(found.scale / 9.81 - 1.0) < 0.25 else "another unit, or the axes?"
        yield Finding(
            "fault",
            "velocity-and-acceleration-scale",
            "units",
            "ax, ay",
            f"velocity changes {found.scale:.2f} times as much as the accelerometer says: {unit}",
            'unit = "g" in the import\'s map; knots or km/h for m/s',
        )


Turned = tuple[Complex, NDArray[np.intp], Callable[[Complex], Complex], Complex, Complex]


def _turned(c: Channels, ahead: str, starboard: str, there: Windows) -> Turned | None:
    """What relates two channels of the body to a track: the track's windows inside them (n,), their blocks, the
    integral over each window of a signal on the fine clock, exp(i psi) and the channels on that clock."""
    t = grid(c[ahead], c[starboard], c["psi"])
    if t.size < 400:
        return None
    inside = (there.t - there.width / 2 > t[0]) & (there.t + there.width / 2 < t[-1])
    at = there.t[inside]
    if at.size < 3 * FEWEST_BLOCKS:
        return None

    def moved(rate: Complex) -> Complex:
        way = cumulative(t, rate)
        ends = [np.interp(at + s * there.width / 2, t, way) for s in (1, -1)]
        return np.asarray(ends[0] - ends[1])

    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
    w = np.interp(t, c[ahead].t, c[ahead].value) + 1j * np.interp(t, c[starboard].t, c[starboard].value)
    return there.d[inside], _blocks(at, there.width), moved, np.exp(1j * psi), w


def _reversed(target: Complex, block: NDArray[np.intp], columns: tuple[Complex, ...]) -> str | None:
    """Whether the first or the second of the columns explains the target with the opposite sign, by itself: surely, and
    at about its size."""
    X = np.column_stack([np.concatenate([z.real, z.imag]) for z in columns])
    y = np.concatenate([target.real, target.imag])
    with np.errstate(over="ignore", invalid="ignore"):
        squares = X.T @ X
    if not np.isfinite(squares).all():  # of infinite ones LAPACK seeks the singular values for ever
        return None
    inverse = np.linalg.pinv(squares)
    beta = inverse @ X.T @ y
    scores = X * (y - X @ beta)[:, None]
    per_block = np.column_stack([_per_block(s[: target.size] + s[target.size :], block) for s in scores.T])
    error = np.sqrt(np.diag(inverse @ per_block.T @ per_block @ inverse))
    for k, name in enumerate(("the first sign is reversed", "the second sign is reversed")):
        if -2.0 < beta[k] < -0.5 and beta[k] < -REVERSED_T * error[k]:
            return name
    return None


def regress(target: Complex, z: Complex, block: NDArray[np.intp], others: tuple[Complex, ...]) -> Fit:
    """The target (n,) as a positive multiple of z (n,) beside any real multiples of ``others`` (n,) each."""
    Y, Z = (np.concatenate([s.real, s.imag]) for s in (target, z))
    if others:
        X = np.column_stack([np.concatenate([o.real, o.imag]) for o in others])
        Y, Z = _without(X, Y), _without(X, Z)
    scale = max(float(Z @ Y) / max(float(Z @ Z), 1e-300), 0.0)
    e = (Y - scale * Z) ** 2
    per_block = _per_block(e[: target.size] + e[target.size :], block) / max(float(Y @ Y), 1e-300)
    return Fit(scale, float(per_block.sum()), per_block)


def preferred(found: Mapping[str, Fit]) -> str | None:
    """The hypothesis that is surely better than "", what the log says; None where none is."""
    best = min(found, key=lambda name: found[name].misfit)
    return best if best and _prefers(found[""].blocks, found[best].blocks) else None


def _prefers(old: Array, new: Array) -> bool:
    """Whether misfits per block (n_blocks,), parts of the whole, say that the new hypothesis is better."""
    gain = old - new
    total = float(gain.sum())
    if gain.size < FEWEST_BLOCKS or total < LEAST_GAIN or new.sum() > MOST_LEFT * old.sum():
        return False
    return total > SIGNIFICANT_T * float(np.std(gain, ddof=1) * np.sqrt(gain.size))


def _blocks(t: Array, width: float) -> NDArray[np.intp]:
    return np.asarray((t - t[0]) // max(BLOCK, 4.0 * width), np.intp)


def _per_block(values: Array, block: NDArray[np.intp]) -> Array:
    return np.asarray(np.bincount(block, values), float)


def _without(columns: Array, values: NDArray[Any]) -> NDArray[Any]:
    """Values (n,) without what the columns (n, k) explain of them."""
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0])
