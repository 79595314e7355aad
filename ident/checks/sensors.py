"""Consistency of sensors: delay, unit and sign of each against the motion that the others measured.

Everything here compares increments over windows, so that offsets drop out and noise is averaged: a sensor's rate is
never differentiated sample by sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import FAULT, WARNING, Finding
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array

Channels = Mapping[str, Channel]
STEP = 0.05  # s, of the common grid
WINDOW = 1.0  # s, over which signals are differenced
LAGS = np.arange(-2.0, 2.0 + STEP / 2, STEP)  # s, that are tried
DELAY_WARNING, DELAY_FAULT = 0.3, 0.6  # s: worth a word; not to be fitted
KNOWN_LATE = 0.2  # s, lower end of a delay's interval from which it is a fault: it biases masses and damping
MIN_ERROR_REDUCTION = 0.3  # of the error, from which a lag is no chance
MIN_R2 = 0.6  # R2 below which two sensors have too little in common to compare their times
BLOCKS, STUDENT = 10, 2.26  # blocks of time of a jackknife, and the 97.5 % quantile of Student's t with 9 d.o.f.
UNKNOWN_DELAY = 0.3  # s, half a 95 % interval from which a delay is not known
SAME_SCALE = 0.15  # by which scales that one clock explains may differ
MIN_YAW_RATE_SD = 0.02  # rad/s, standard deviation below which the boat has hardly turned
MIN_VELOCITY_SD = 0.1  # m/s, standard deviation below which the boat has hardly moved


class LagEstimate(NamedTuple):
    """A lag [s] with its standard error [s], and the R2 of the regression at that lag."""

    lag: float
    se: float
    r2: float

    @property
    def half(self) -> float:
        """Half the width of the 95 % interval [s], by Student's t of the blocks."""
        return STUDENT * self.se


class LagErrors:
    """Errors of a regression at each lag, by blocks of time, for the best lag and its jackknife.

    Parameters
    ----------
    lags
        That are tried (n_lags,) [s], evenly spaced.
    n_rows
        Rows of one regression, in the order of time.
    """

    def __init__(self, lags: Array, n_rows: int) -> None:
        self._lags = lags
        self._edges = np.linspace(0, n_rows, BLOCKS + 1).astype(int)
        self._whole: list[float] = []
        self._without: list[list[float]] = []

    def add(self, X: Array, y: Array) -> None:
        """Add the regression of y (n_rows,) on X (n_rows, k) at the next lag. With several outputs the rows of one
        output come after those of the other."""
        n_rows = int(self._edges[-1])
        scale = np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300)  # so that the normal matrix is well conditioned
        k = X.shape[1]
        A, b, s = np.zeros((BLOCKS, k, k)), np.zeros((BLOCKS, k)), np.zeros(BLOCKS)
        for start in range(0, y.size, n_rows):
            for j, (first, last) in enumerate(pairwise((self._edges + start).tolist())):
                part, y_part = X[first:last] / scale, y[first:last]
                A[j] += part.T @ part
                b[j] += part.T @ y_part
                s[j] += y_part @ y_part
        errors = _unexplained(
            np.concatenate([A.sum(0)[None], A.sum(0) - A]),
            np.concatenate([b.sum(0)[None], b.sum(0) - b]),
            np.append(s.sum(), s.sum() - s),
        )
        self._whole.append(float(errors[0]))
        self._without.append(errors[1:].tolist())

    def estimate(self) -> LagEstimate:
        """The lag with the least error."""
        each = np.array([self._least(error) for error in np.array(self._without).T])
        se = float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((each - each.mean()) ** 2)))
        whole = np.array(self._whole)
        return LagEstimate(self._least(whole), se, 1.0 - float(whole.min()))

    def _least(self, error: Array) -> float:
        """The lag of the least error, by a parabola through it and its neighbours."""
        k = int(np.argmin(error))
        if not 0 < k < error.size - 1:
            return float(self._lags[k])
        bend = float(error[k - 1] - 2.0 * error[k] + error[k + 1])
        step = float(self._lags[1] - self._lags[0])
        return float(self._lags[k]) + (0.5 * step * float(error[k - 1] - error[k + 1]) / bend if bend > 0.0 else 0.0)


def _unexplained(A: Array, b: Array, s: Array) -> Array:
    """The shares (m,) of the sums of squares s (m,) that regressions do not explain, whose normal equations are
    A beta = b, (m, k, k) and (m, k)."""
    beta = np.einsum("mij,mj->mi", np.linalg.pinv(A, rcond=1e-10, hermitian=True), b)
    return np.asarray(np.maximum(s - np.sum(b * beta, axis=1), 0.0) / np.maximum(s, 1e-300))


class Match(NamedTuple):
    """How one signal follows another: it is ``scale`` times as large and comes ``lag`` s later.

    r2 at that lag; gain: part of the error without a lag that the lag explains; half: half the width of the 95 %
    interval of the lag [s].
    """

    scale: float
    lag: float
    r2: float
    gain: float = 0.0
    half: float = 0.0


class Matches(NamedTuple):
    """How integrals follow what they should be: heading the yaw rate, positions the velocity over ground, velocity over
    ground the specific force; None where one is missing or the boat hardly moves."""

    heading: Match | None
    position: Match | None
    velocity: Match | None


def sensor_matches(c: Channels) -> Matches:
    """All of them, each regression once."""
    return Matches(heading_match(c), position_match(c), velocity_match(c))


def check_time_scale(found: Matches) -> Finding | None:
    """One factor between every integral and what it should be: time counts in another unit."""
    scales = [abs(m.scale) for m in found if m is not None and m.r2 > MIN_R2]
    common = float(np.median(scales)) if scales else 1.0
    if len(scales) < 2 or 0.75 < common < 1.33 or any(abs(s / common - 1.0) > SAME_SCALE for s in scales):
        return None
    return Finding(
        "fault",
        "time-scale",
        "time",
        "all of it",
        f"everything moves {common:.3g} times as fast as {len(scales)} sensors of rates say: the clock, not a sensor",
        "[time] format, column or rate_hz in the import's map",
    )


def gyro_and_heading(c: Channels, found: Match | None) -> Iterator[Finding]:
    """The heading turns as much as the yaw rate says, and at the same time; its sense is a matter of frames."""
    if found is None:
        return
    where = _who(c["r"], "r")
    size = abs(found.scale)
    if found.r2 < MIN_R2:
        yield Finding(
            "warning",
            "heading-and-gyro-disagree",
            "gyro",
            where,
            f"heading and yaw rate agree only to R2 {found.r2:.2f}",
            "is one of them of another sensor, stuck, or disturbed by iron?",
        )
        return
    if 30.0 < 1.0 / size < 120.0 or 30.0 < size < 120.0:
        radians = np.abs(c["psi"].value).max() < 7.0
        what = "yaw rate in deg/s" if radians else "both in degrees"
        if size > 1.0:
            what = "a yaw rate in rad/s that was declared deg/s" + ("" if radians else ", or a heading in degrees")
        yield Finding(
            "fault",
            "angle-in-degrees",
            "units",
            where,
            f"yaw rate is {1.0 / size:.3g} times the change of heading: {what}?",
            "the unit in the sensor's settings or in the import's map",
        )
    elif not 0.7 < size < 1.4:
        yield Finding(
            "fault" if not 0.6 < size < 1.67 else "warning",  # a compass that motors draw aside lags or leads in turns
            "gyro-scale",
            "gyro",
            where,
            f"yaw rate is {1.0 / size:.3g} times the change of heading",
            "range or scale of the gyro; a heading that lags in turns; or the log's clock runs at another rate",
        )
    elif found.scale > 0.0:
        yield Finding(
            "ok", "gyro-as-expected", "gyro", where, f"yaw rate is {1.0 / size:.2f} times the change of heading"
        )
    yield from sensor_delay("heading", _who(c["psi"], "psi"), "yaw rate", where, found)


def heading_match(c: Channels) -> Match | None:
    """Increments of heading on those of the integrated yaw rate; None where the boat has hardly turned."""
    if not {"psi", "r"} <= set(c):
        return None
    psi, r = c["psi"], c["r"]
    t = grid(psi, r)
    if t.size < 200:
        return None
    turned = np.interp(t, psi.t, np.unwrap(psi.value, period=_turn(psi.value)))
    integral = cumulative(t, np.interp(t, r.t, r.value))
    ahead = round(WINDOW / STEP)
    moved = [float(np.std(s[ahead:] - s[:-ahead])) for s in (turned, integral)]
    if max(moved) < MIN_YAW_RATE_SD * WINDOW or min(moved) < 1e-9:
        return None
    return _best([turned], [[integral], [t]])


def velocity_match(c: Channels) -> Match | None:
    """Increments of the velocity over ground on the specific force turned by the heading; None for a calm run.

    An antenna away from the accelerometers has a velocity of its own in every turn, which a lag of either sign explains
    in part: where yaw rate is measured, that of an arm ahead and one to starboard is regressed on, too.
    """
    names = ("psi", "ax", "ay", "vx", "vy")
    if not set(names) <= set(c) or c["vx"].t.size < 50:
        return None
    t = grid(*(c[n] for n in names))
    if t.size < 400 or np.hypot(c["vx"].value.std(), c["vy"].value.std()) < MIN_VELOCITY_SD:
        return None
    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
    ax, ay = (np.interp(t, c[n].t, c[n].value) for n in ("ax", "ay"))
    cos, sin = np.cos(psi), np.sin(psi)
    north = [cumulative(t, s) for s in (cos * ax - sin * ay, cos, -sin)]
    east = [cumulative(t, s) for s in (sin * ax + cos * ay, sin, cos)]
    if "r" in c:
        r = np.interp(t, c["r"].t, c["r"].value)
        north, east = [*north, -r * sin, -r * cos], [*east, r * cos, -r * sin]
    moved = [np.interp(t, c[n].t, c[n].value) for n in ("vx", "vy")]
    return _best(moved, [[n, e] for n, e in zip(north, east, strict=True)], 2.0)


def velocity_and_acceleration(c: Channels, found: Match | None) -> Iterator[Finding]:
    """GNSS velocity changes when the accelerometer says so; whether by as much is a matter of frames."""
    if found is None or found.r2 < 0.3:
        return
    gnss, ahrs = _who(c["vx"], "GNSS"), _who(c["ax"], "ax")
    yield from sensor_delay("velocity", gnss, "acceleration", ahrs, found, confounded=True)


def position_match(c: Channels) -> Match | None:
    """Increments of the positions on the integrated velocity over ground; None for a boat at rest."""
    if not {"x", "y", "vx", "vy"} <= set(c):
        return None
    t = grid(*(c[n] for n in ("x", "y", "vx", "vy")))
    way, velocity = ([np.interp(t, c[n].t, c[n].value) for n in names] for names in (("x", "y"), ("vx", "vy")))
    if t.size < 400 or np.median(np.hypot(*velocity)) < 0.1:
        return None
    return _best(way, [[cumulative(t, v) for v in velocity]], 5.0)


def position_and_velocity(c: Channels, found: Match | None) -> Iterator[Finding]:
    """Positions change as the velocity over ground says."""
    if found is None:
        return
    where = _who(c["vx"], "vx")
    if found.r2 < MIN_R2:
        yield Finding(
            "warning",
            "position-and-velocity-disagree",
            "gnss",
            where,
            f"position and velocity agree only to R2 {found.r2:.2f}",
            "outliers, multipath, or another column",
        )
        return
    if not 0.75 < found.scale < 1.33:
        known = {0.514: "knots", 0.278: "km/h", 3.6: "km/h", 1.944: "knots"}
        unit = next((u for k, u in known.items() if abs(found.scale / k - 1.0) < 0.1), "another unit")
        yield Finding(
            "fault",
            "velocity-unit",
            "units",
            where,
            f"positions change {found.scale:.3g} times as fast as the velocity says: {unit}?",
            "the unit of the velocity or the positions in the import's map; or the log's clock runs at another rate",
        )
    yield from sensor_delay("position", _who(c["x"], "x"), "velocity", where, found)


def delay_level(lag: float, half: float, fault_from: float = DELAY_FAULT) -> str:
    """Return the level of a delay ``lag`` [s] whose 95 % interval has half the width ``half`` [s]."""
    return FAULT if lag >= fault_from or lag - half > KNOWN_LATE else WARNING


def delay_interval(lag: float, half: float) -> str:
    """Return a 95 % interval [s] in words, without a negative zero."""
    low, high = (round(end, 2) + 0.0 for end in (lag - half, lag + half))
    return f"95 %: {low:.2f} to {high:.2f} s"


def sensor_delay(
    one: str, where: str, other: str, there: str, found: Match, *, confounded: bool = False
) -> Iterator[Finding]:
    """What a lag of ``one`` behind ``other`` means, where it explains something.

    ``confounded``: something else than a delay, such as a lever arm, explains a part of it: a small one is no fault.
    """
    late, behind, at = (one, other, where) if found.lag > 0 else (other, one, there)
    interval = delay_interval(abs(found.lag), found.half)
    if found.gain > MIN_ERROR_REDUCTION and abs(found.lag) >= DELAY_WARNING - STEP / 2:
        level = delay_level(abs(found.lag), np.inf if confounded else found.half)
        text = f"{late} comes {abs(found.lag):.2f} s after {behind} ({interval})"
        yield Finding(level, "sensor-late", "late", at, text, "its filters, output rate or time stamps")
    elif found.half > UNKNOWN_DELAY or abs(found.lag) >= DELAY_WARNING - STEP / 2:
        text = f"the time between {one} and {other} is not known ({interval})"
        yield Finding("ok", "delay-unknown", "late", where, text)
    else:
        text = f"{one} and {other} are {abs(found.lag):.2f} s apart ({interval})"
        yield Finding("ok", "sensors-in-time", "late", where, text)


def _best(columns: list[Array], regressors: list[list[Array]], window: float = WINDOW) -> Match:
    """The lag at which increments of the columns are best explained, and the factor of the first regressor there.

    A regressor has as many columns as there are to be explained; all share its factor.
    """
    ahead, most = round(window / STEP), round(float(LAGS[-1]) / STEP)
    at = np.arange(most, columns[0].size - most - ahead, max(1, ahead // 2))
    y = np.concatenate([column[at + ahead] - column[at] for column in columns])
    best, unmoved = Match(np.nan, np.nan, -np.inf), -np.inf
    errors = LagErrors(LAGS, at.size)
    for lag in LAGS:
        late = at - round(float(lag) / STEP)
        X = np.column_stack([np.concatenate([s[late + ahead] - s[late] for s in one]) for one in regressors])
        beta, *_ = np.linalg.lstsq(X, y, rcond=None)
        e = y - X @ beta
        errors.add(X, y)
        r2 = 1.0 - float(e @ e) / max(float(y @ y), 1e-300)
        if abs(lag) < STEP / 2:
            unmoved = r2
        if r2 > best.r2:
            best = Match(float(beta[0]), float(lag), r2)
    return best._replace(
        gain=1.0 - (1.0 - best.r2) / max(1.0 - unmoved, 1e-12), half=float(np.hypot(errors.estimate().half, STEP / 2))
    )


def cumulative(t: Array, rate: NDArray[Any]) -> NDArray[Any]:
    """Integral (n,) of a rate (n,) at times t (n,) [s], from zero, by trapezoids."""
    return np.append(np.zeros(1, rate.dtype), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))


def grid(*channels: Channel) -> Array:
    start, end = max(c.t[0] for c in channels), min(c.t[-1] for c in channels)
    return np.arange(start, end, STEP)


def _turn(psi: Array) -> float:
    """A whole turn of a heading by the range of its values: in radians, in degrees, or converted twice."""
    if np.abs(psi).max() > 7.0:
        return 360.0
    return 2.0 * np.pi if np.ptp(psi) > np.radians(2.0 * np.pi) else np.radians(2.0 * np.pi)


def _who(channel: Channel, name: str) -> str:
    return channel.source or name
