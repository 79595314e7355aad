"""Consistency of sensors: delay, unit and sign of each sensor against the motion that other sensors measure.

All comparisons use increments over windows. Offsets cancel in increments, and the window averages the noise. No signal
is differentiated sample by sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import FAULT, UNKNOWN, WARNING, Finding
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array, cumulative_integral

Channels = Mapping[str, Channel]
SENSOR_GRID_S = 0.05  # s, of the common grid
WINDOW = 1.0  # s, over which signals are differenced
LAGS = np.arange(-2.0, 2.0 + SENSOR_GRID_S / 2, SENSOR_GRID_S)  # s, values of the search
# End of the advice about a delay: a fit that estimates the latency of a sensor may find another value.
DELAY_OF_PAIR = (
    "this is the delay between these two signals; a diagnosis estimates the latency of a sensor (such as gnss-latency) "
    "itself, and its value can differ"
)
DELAY_WARNING, DELAY_FAULT = 0.3, 0.6  # s; delays from these values on give a warning, a fault
KNOWN_LATE = 0.2  # s; a delay whose whole 95 % interval is above this value biases masses and damping: a fault
MIN_ERROR_REDUCTION = 0.3  # of the squared error; a lag that removes less may be chance
MIN_R2 = 0.6  # R2 below which two sensors have too little in common to compare their times
BLOCKS, STUDENT = 10, 2.26  # blocks of time of a jackknife, and the 97.5 % quantile of Student's t with 9 d.o.f.
UNKNOWN_DELAY = 0.3  # s; a delay with a wider half 95 % interval is unknown
SAME_SCALE = 0.15  # largest relative difference of scales that one wrong clock explains
SAME_UNIT = (0.75, 1.33)  # change of a track over its measured velocity, outside of which the units differ
MIN_YAW_RATE_SD = 0.02  # rad/s, standard deviation below which the boat has hardly turned
MIN_VELOCITY_SD = 0.1  # m/s, standard deviation below which the boat has hardly moved


class LagEstimate(NamedTuple):
    """Estimated lag between two signals.

    Attributes
    ----------
    lag
        Lag [s] with the least squared error. Positive: the output comes after the shifted regressors.
    se
        Standard error [s] of the lag, by the jackknife over 10 blocks of time.
    r2
        Coefficient of determination of the regression at this lag: explained share of the sum of squares, without
        subtraction of a mean.
    """

    lag: float
    se: float
    r2: float

    @property
    def half(self) -> float:
        """Half width of the 95 % interval [s], by Student's t for the number of blocks."""
        return STUDENT * self.se


class LagErrors:
    """Search for the lag of a regression with the least squared error, with a jackknife standard error.

    The rows are divided into 10 blocks of time. The errors of all blocks give the best lag. The errors without one
    block, for each block in turn, give its standard error (jackknife). Call `add` for each lag, and then `estimate`.

    Parameters
    ----------
    lags
        Lags of the search (n_lags,) [s], evenly spaced, at least three.
    n_rows
        Number of rows of one output in a regression, in the order of time.
    """

    def __init__(self, lags: Array, n_rows: int) -> None:
        """Divide the rows into blocks. The search has no regression yet."""
        self._lags = lags
        self._edges = np.linspace(0, n_rows, BLOCKS + 1).astype(int)
        self._products: list[Array] = []  # of each lag, by block: (BLOCKS, k + 1, k + 1)

    def add(self, X: Array, y: Array) -> None:
        """Add the regression at the next lag. Call it once for each of the lags, in their order.

        Parameters
        ----------
        X
            Regressors (n_outputs * n_rows, k). The rows of the second output follow those of the first.
        y
            Outputs (n_outputs * n_rows,), in the same order.
        """
        scale = np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300)  # so that the normal matrix is well conditioned
        columns = np.column_stack([X / scale, y]).reshape(-1, int(self._edges[-1]), X.shape[1] + 1)
        blocks = [columns[:, first:last].reshape(-1, columns.shape[2]) for first, last in pairwise(self._edges)]
        self._products.append(np.array([block.T @ block for block in blocks]))

    def estimate(self) -> LagEstimate:
        """Return the lag with the least squared error and its standard error, after `add` for all lags."""
        products = np.array(self._products)  # (n_lags, BLOCKS, k + 1, k + 1)
        whole = products.sum(axis=1, keepdims=True)
        k = products.shape[2] - 1
        all_and_without = np.concatenate([whole, whole - products], axis=1).reshape(-1, k + 1, k + 1)
        errors = _unexplained_share(
            all_and_without[:, :k, :k], all_and_without[:, :k, k], all_and_without[:, k, k]
        ).reshape(len(products), BLOCKS + 1)
        each = np.array([self._refined_minimum(error) for error in errors.T[1:]])
        se = float(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((each - each.mean()) ** 2)))
        whole = errors[:, 0]
        return LagEstimate(self._refined_minimum(whole), se, 1.0 - float(whole.min()))

    def _refined_minimum(self, error: Array) -> float:
        """Return the lag [s] of the least squared error (n_lags,), refined by a parabola through its neighbours.

        Of equal errors the first counts. At either end of the search the lag is not refined.
        """
        k = int(np.argmin(error))
        if not 0 < k < error.size - 1:
            return float(self._lags[k])
        bend = float(error[k - 1] - 2.0 * error[k] + error[k + 1])
        step = float(self._lags[1] - self._lags[0])
        return float(self._lags[k]) + (0.5 * step * float(error[k - 1] - error[k + 1]) / bend if bend > 0.0 else 0.0)


def _unexplained_share(A: Array, b: Array, s: Array) -> Array:
    """Return the unexplained share (m,) of the sum of squares of the output, for each of m regressions.

    The normal equations of each regression are A beta = b, with A (m, k, k) and b (m, k). ``s`` (m,) are the sums of
    squares of the outputs. A singular A is allowed.
    """
    beta = np.einsum("mij,mj->mi", np.linalg.pinv(A, rcond=1e-10, hermitian=True), b)
    return np.asarray(np.maximum(s - np.sum(b * beta, axis=1), 0.0) / np.maximum(s, 1e-300))


class Match(NamedTuple):
    """Relation of two signals: the first is ``scale`` times the second, delayed by ``lag``.

    Attributes
    ----------
    scale
        Factor of the second signal. NaN if no lag could be evaluated.
    lag
        Delay [s] of the first signal behind the second, with the largest R2. Negative: the second one is late. NaN if
        no lag could be evaluated.
    r2
        Coefficient of determination at this lag: explained share of the sum of squares of the increments, without
        subtraction of their mean.
    gain
        Part of the squared error without a lag that the lag removes, 0 to 1.
    half
        Half width [s] of the 95 % interval of the lag.
    """

    scale: float
    lag: float
    r2: float
    gain: float = 0.0
    half: float = 0.0


class Matches(NamedTuple):
    """Relations of three measured signals to the integrals of their measured rates.

    A relation is None if a signal is missing, the common time is too short (10 s for the heading, 20 s for the others),
    or the boat hardly moves (`heading_match`, `position_match`, `velocity_match`).

    Attributes
    ----------
    heading
        Heading, and integral of the yaw rate.
    position
        Position, and integral of the velocity over ground.
    velocity
        Velocity over ground, and integral of the specific force turned by the heading.
    """

    heading: Match | None
    position: Match | None
    velocity: Match | None


def sensor_matches(c: Channels) -> Matches:
    """Compare each pair of sensors, one of which measures the rate of the other.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.

    Returns
    -------
    Matches
        Relations of heading and yaw rate, position and velocity over ground, velocity and specific force. A relation is
        None if a signal is missing, the common time is too short, or the boat hardly moves, by the limits of
        `heading_match`, `position_match` and `velocity_match`.
    """
    return Matches(heading_match(c), position_match(c), velocity_match(c))


def check_time_scale(found: Matches) -> Finding | None:
    """Return a fault if all integrals are wrong by the same factor: then the time is in another unit.

    Parameters
    ----------
    found
        Relations of the sensors of one log.

    Returns
    -------
    Finding or None
        None if fewer than two relations have an R2 above 0.6, or if their factors differ by more than 15 % or are near
        one (0.75 to 1.33).
    """
    scales = [abs(m.scale) for m in found if m is not None and m.r2 > MIN_R2]
    common = float(np.median(scales)) if scales else 1.0
    if len(scales) < 2 or 0.75 < common < 1.33 or any(abs(s / common - 1.0) > SAME_SCALE for s in scales):
        return None
    return Finding(
        "fault",
        "time-scale",
        "time",
        "all signals",
        f"rates of change of {len(scales)} pairs of sensors differ by one factor, {common:.3g}: the time stamps have a "
        "wrong unit or rate",
        "correct format, column or rate_hz under [time] in the import map",
    )


def gyro_and_heading(c: Channels, found: Match | None) -> Iterator[Finding]:
    """Yield findings on scale and delay between heading and yaw rate.

    The sign is the task of `seatrial.ident.checks.frames`. With an R2 below 0.6 the only finding is
    ``heading-and-gyro-disagree`` (warning). Otherwise the factor (change of heading over yaw rate) gives
    ``angle-in-degrees`` (fault, if the factor or its inverse is 30 to 120), ``gyro-scale`` (warning outside 0.7 to 1.4,
    fault outside 0.6 to 1.67) or ``gyro-as-expected`` (ok), all by its size; a negative factor of the right size gives
    none of them. The delay follows (`sensor_delay`).

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    found
        Relation of heading and yaw rate (`heading_match`). None gives no finding.
    """
    if found is None:
        return
    where = _source_or_name(c["r"], "r")
    size = abs(found.scale)
    if found.r2 < MIN_R2:
        yield Finding(
            "warning",
            "heading-and-gyro-disagree",
            "gyro",
            where,
            f"the change of heading and the yaw rate hardly agree (R2 {found.r2:.2f})",
            "check whether one of them is stuck, belongs to another sensor, or is disturbed by iron or motors",
        )
        return
    if 30.0 < 1.0 / size < 120.0 or 30.0 < size < 120.0:
        radians = np.abs(c["psi"].value).max() < 7.0
        cause = "yaw rate in deg/s" if radians else "both in degrees"
        if size > 1.0:
            cause = "a yaw rate in rad/s that was declared deg/s" + ("" if radians else ", or a heading in degrees")
        yield Finding(
            "fault",
            "angle-in-degrees",
            "units",
            where,
            f"the yaw rate is {1.0 / size:.3g} times the change of heading: {cause}?",
            "correct the unit in the sensor's settings or in the import map",
        )
    elif not 0.7 < size < 1.4:
        yield Finding(
            # Only a warning near one: the field of the motors makes a compass lag or lead in turns.
            "fault" if not 0.6 < size < 1.67 else "warning",
            "gyro-scale",
            "gyro",
            where,
            f"the yaw rate is {1.0 / size:.3g} times the change of heading",
            "check range and scale of the gyro, whether the heading lags in turns, and the rate of the time stamps",
        )
    elif found.scale > 0.0:
        yield Finding(
            "ok", "gyro-as-expected", "gyro", where, f"yaw rate is {1.0 / size:.2f} times the change of heading"
        )
    yield from sensor_delay("heading", _source_or_name(c["psi"], "psi"), "yaw rate", where, found)


def heading_match(c: Channels) -> Match | None:
    """Regress increments of the heading over 1 s on those of the integrated yaw rate.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. The heading may be in radians or degrees.

    Returns
    -------
    Match or None
        None if heading or yaw rate is missing, if both overlap for less than 10 s, or if the boat has hardly turned
        (standard deviation of the increments of both below 0.02 rad, or of one about zero).
    """
    if not {"psi", "r"} <= set(c):
        return None
    psi, r = c["psi"], c["r"]
    t = common_grid(psi, r)
    if t.size < 200:
        return None
    turned = np.interp(t, psi.t, np.unwrap(psi.value, period=_full_turn(psi.value)))
    integral = cumulative_integral(t, np.interp(t, r.t, r.value))
    width = round(WINDOW / SENSOR_GRID_S)
    moved = [float(np.std(s[width:] - s[:-width])) for s in (turned, integral)]
    if max(moved) < MIN_YAW_RATE_SD * WINDOW or min(moved) < 1e-9:
        return None
    return _best_lag([turned], [[integral], [t]])


def velocity_match(c: Channels) -> Match | None:
    """Regress increments of the velocity over 2 s on those of the integrated specific force, turned by the heading.

    The velocity is that over ground, and the bias of each accelerometer axis is a further regressor.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.

    Returns
    -------
    Match or None
        None if a signal is missing, if all signals overlap for less than 20 s, if the velocity has fewer than 50
        samples, or if the boat hardly moves (standard deviation of the velocity below 0.1 m/s).

    Notes
    -----
    An antenna with a lever arm has an additional velocity in turns, which a lag of either sign explains in part. If the
    yaw rate is measured, the velocities of a lever arm forward and to starboard are regressors too.
    """
    names = ("psi", "ax", "ay", "vx", "vy")
    if not set(names) <= set(c) or c["vx"].t.size < 50:
        return None
    t = common_grid(*(c[n] for n in names))
    if t.size < 400 or np.hypot(c["vx"].value.std(), c["vy"].value.std()) < MIN_VELOCITY_SD:
        return None
    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
    ax, ay = (np.interp(t, c[n].t, c[n].value) for n in ("ax", "ay"))
    cos, sin = np.cos(psi), np.sin(psi)
    north = [cumulative_integral(t, s) for s in (cos * ax - sin * ay, cos, -sin)]
    east = [cumulative_integral(t, s) for s in (sin * ax + cos * ay, sin, cos)]
    if "r" in c:
        r = np.interp(t, c["r"].t, c["r"].value)
        north, east = [*north, -r * sin, -r * cos], [*east, r * cos, -r * sin]
    moved = [np.interp(t, c[n].t, c[n].value) for n in ("vx", "vy")]
    return _best_lag(moved, [[n, e] for n, e in zip(north, east, strict=True)], 2.0)


def velocity_and_acceleration(c: Channels, found: Match | None) -> Iterator[Finding]:
    """Yield a finding on the delay between GNSS velocity and accelerometer.

    The scale is the task of `seatrial.ident.checks.frames.check_accelerometer`.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    found
        Relation of velocity and specific force (`velocity_match`). None, or an R2 below 0.3, gives no finding.
    """
    if found is None or found.r2 < 0.3:
        return
    gnss, ahrs = _source_or_name(c["vx"], "GNSS"), _source_or_name(c["ax"], "ax")
    yield from sensor_delay("velocity", gnss, "acceleration", ahrs, found, confounded=True)


def position_match(c: Channels) -> Match | None:
    """Regress increments of the position over 5 s on those of the integrated velocity over ground.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.

    Returns
    -------
    Match or None
        None if a signal is missing, if all signals overlap for less than 20 s, or if the median speed is below 0.1 m/s.
    """
    if not {"x", "y", "vx", "vy"} <= set(c):
        return None
    t = common_grid(*(c[n] for n in ("x", "y", "vx", "vy")))
    position, velocity = ([np.interp(t, c[n].t, c[n].value) for n in names] for names in (("x", "y"), ("vx", "vy")))
    if t.size < 400 or np.median(np.hypot(*velocity)) < 0.1:
        return None
    return _best_lag(position, [[cumulative_integral(t, v) for v in velocity]], 5.0)


def position_and_velocity(c: Channels, found: Match | None) -> Iterator[Finding]:
    """Yield findings on scale and delay between position and velocity over ground.

    With an R2 below 0.6 the only finding is ``position-and-velocity-disagree`` (warning). Otherwise a factor outside
    0.75 to 1.33 gives ``velocity-unit`` (fault), and the delay follows (`sensor_delay`).

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    found
        Relation of position and velocity (`position_match`). None gives no finding.
    """
    if found is None:
        return
    where = _source_or_name(c["vx"], "vx")
    if found.r2 < MIN_R2:
        yield Finding(
            "warning",
            "position-and-velocity-disagree",
            "gnss",
            where,
            f"the change of position and the velocity hardly agree (R2 {found.r2:.2f})",
            "look for outliers and multipath, and check that both signals are from one receiver",
        )
        return
    if not SAME_UNIT[0] < found.scale < SAME_UNIT[1]:
        yield velocity_unit_fault("the position", "the measured velocity", found.scale, where)
    yield from sensor_delay("position", _source_or_name(c["x"], "x"), "velocity", where, found)


def velocity_unit_fault(track: str, velocity: str, scale: float, where: str) -> Finding:
    """Return the fault ``velocity-unit``: a track moves faster or slower than a velocity says.

    Parameters
    ----------
    track, velocity
        Names of both in the text, with article, for example ``the position``.
    scale
        Change of the track per unit of time over the velocity.
    where
        Signal or device of the velocity.

    Returns
    -------
    Finding
        It asks for the unit that explains the factor to 10 %.
    """
    # A velocity in knots that is taken as m/s is too large, and one in m/s that is converted from knots too small.
    units = {
        0.514: "are its numbers in knots and taken as m/s?",
        0.278: "are its numbers in km/h and taken as m/s?",
        1.944: "are its numbers in m/s and converted as knots?",
        3.6: "are its numbers in m/s and converted as km/h?",
    }
    question = next((q for k, q in units.items() if abs(scale / k - 1.0) < 0.1), "is it in another unit?")
    return Finding(
        "fault",
        "velocity-unit",
        "units",
        where,
        f"{track} changes {scale:.3g} times as fast as {velocity}, which is too "
        f"{'large' if scale < 1.0 else 'small'}: {question}",
        "correct the unit of the velocity or position in the import map, or check the rate of the time stamps",
    )


def delay_level(lag: float, half: float, fault_from: float = DELAY_FAULT) -> str:
    """Return the severity of the finding on a delay: ``fault`` or ``warning``.

    Parameters
    ----------
    lag, half
        Delay and half width of its 95 % interval [s], both positive.
    fault_from
        Delay [s] from which it is a fault, however wide its interval is. A smaller delay is a fault if its whole
        interval is above 0.2 s.
    """
    return FAULT if lag >= fault_from or lag - half > KNOWN_LATE else WARNING


def delay_interval(lag: float, half: float) -> str:
    """Return the 95 % interval of a delay as text, for example ``95 %: 0.30 to 0.50 s``. Its low end may be negative.

    Parameters
    ----------
    lag, half
        Delay and half width of its interval [s].
    """
    low, high = (round(end, 2) + 0.0 for end in (lag - half, lag + half))  # + 0.0: no "-0.00"
    return f"95 %: {low:.2f} to {high:.2f} s"


def why_no_warning(lag: float, half: float, *, fitted: bool = True) -> str:
    """Return the end of the text of a short delay: why it is no warning, or the largest delay in its interval.

    It is empty if the 95 % interval contains zero and ends below the limit of a warning.

    Parameters
    ----------
    lag, half
        Delay and half width of its interval [s].
    fitted
        Whether a fit has a common error that corrects such a delay.
    """
    largest = f"the log does not exclude a delay of up to {lag + half:.2f} s"
    if round(lag - half, 2) <= 0.0:
        return f"; {largest}" if lag + half >= DELAY_WARNING else ""
    text = f"; too short for a warning, which begins at {DELAY_WARNING:g} s"
    if lag + half >= DELAY_WARNING:
        text += f", although {largest}"
    return text + "; a fit estimates and corrects it if it matters" * fitted


def sensor_delay(
    first: str, first_source: str, second: str, second_source: str, found: Match, *, confounded: bool = False
) -> Iterator[Finding]:
    """Yield one finding on the delay between two sensors.

    Parameters
    ----------
    first, first_source
        Quantity and source of the signal that is late if the lag is positive.
    second, second_source
        Quantity and source of the other signal.
    found
        Relation of both signals.
    confounded
        Whether another cause, for example a lever arm, may explain a part of the lag. A lag below 0.6 s is then a
        warning, not a fault.

    Yields
    ------
    Finding
        ``sensor-late`` (warning or fault by `delay_level`) for a lag of at least 0.3 s, less half a step of the search
        (0.025 s), that removes more than 30 % of the squared error. ``delay-unknown`` (unknown) for another lag of this
        size, which may be chance, or if the half interval is wider than 0.3 s. Else ``sensors-in-time`` (ok).
    """
    late, early, late_source = (first, second, first_source) if found.lag > 0 else (second, first, second_source)
    interval = delay_interval(abs(found.lag), found.half)
    if found.gain > MIN_ERROR_REDUCTION and abs(found.lag) >= DELAY_WARNING - SENSOR_GRID_S / 2:
        level = delay_level(abs(found.lag), np.inf if confounded else found.half)
        text = f"{late} comes {abs(found.lag):.2f} s after {early} ({interval})"
        advice = f"check filters, output rate and time stamps of the {late}; {DELAY_OF_PAIR}"
        yield Finding(level, "sensor-late", "late", late_source, text, advice)
    elif found.half > UNKNOWN_DELAY or abs(found.lag) >= DELAY_WARNING - SENSOR_GRID_S / 2:
        # If the best lag hardly explains the error, it may be chance, and its interval says nothing.
        why = (
            interval
            if found.half > UNKNOWN_DELAY
            else f"the best lag removes only {100 * found.gain:.0f} % of the error"
        )
        text = f"the delay between {first} and {second} is not known ({why})"
        yield Finding(UNKNOWN, "delay-unknown", "late", first_source, text)
    else:
        same = abs(found.lag) < SENSOR_GRID_S / 2
        text = f"{first} and {second} agree in time" if same else f"{late} comes {abs(found.lag):.2f} s after {early}"
        # The latency of a fix delays position and velocity alike, so that no fit has a delay between the two.
        fitted = {first, second} != {"position", "velocity"}
        text += f" ({interval}){why_no_warning(abs(found.lag), found.half, fitted=fitted)}"
        yield Finding("ok", "sensors-in-time", "late", late_source, text)


def _best_lag(columns: list[Array], regressors: list[list[Array]], window: float = WINDOW) -> Match:
    """Find the lag between -2 and 2 s at which the regressors explain increments of the measured columns best.

    Parameters
    ----------
    columns
        Measured signals (n,) on the common grid with a step of 0.05 s, such as position north and east.
    regressors
        Each regressor has one array (n,) for each column, and one factor for all of them.
    window
        Time [s] over which increments are taken.

    Returns
    -------
    Match
        ``scale`` is the factor of the first regressor. A positive lag: the columns come after the regressors. The lag
        is one of the grid, without refinement between its steps.
    """
    width, most = round(window / SENSOR_GRID_S), round(float(LAGS[-1]) / SENSOR_GRID_S)
    at = np.arange(most, columns[0].size - most - width, max(1, width // 2))
    y = np.concatenate([column[at + width] - column[at] for column in columns])
    best, unmoved = Match(np.nan, np.nan, -np.inf), -np.inf
    errors = LagErrors(LAGS, at.size)
    for lag in LAGS:
        late = at - round(float(lag) / SENSOR_GRID_S)
        X = np.column_stack([np.concatenate([s[late + width] - s[late] for s in arrays]) for arrays in regressors])
        beta, *_ = np.linalg.lstsq(X, y, rcond=None)
        e = y - X @ beta
        errors.add(X, y)
        r2 = 1.0 - float(e @ e) / max(float(y @ y), 1e-300)
        if abs(lag) < SENSOR_GRID_S / 2:
            unmoved = r2
        if r2 > best.r2:
            best = Match(float(beta[0]), float(lag), r2)
    return best._replace(
        gain=1.0 - (1.0 - best.r2) / max(1.0 - unmoved, 1e-12),
        half=float(np.hypot(errors.estimate().half, SENSOR_GRID_S / 2)),
    )


def common_grid(*channels: Channel) -> Array:
    """Return times (n,) [s] at steps of 0.05 s (`SENSOR_GRID_S`) in the span that all channels cover.

    The first time is the start of the span; its end is not included. The result is empty if they do not overlap.

    Parameters
    ----------
    channels
        At least one channel.
    """
    start, end = max(c.t[0] for c in channels), min(c.t[-1] for c in channels)
    return np.arange(start, end, SENSOR_GRID_S)


def _full_turn(psi: Array) -> float:
    """Return a whole turn in the unit of a heading (n,): 360 for degrees, 2 pi for radians, or 2 pi / 57.3.

    The last one is the turn of radians that were converted by mistake as if they were degrees. The heading is in
    degrees if a value exceeds 7, and was converted by mistake if the values span at most 0.11.
    """
    if np.abs(psi).max() > 7.0:
        return 360.0
    return 2.0 * np.pi if np.ptp(psi) > np.radians(2.0 * np.pi) else np.radians(2.0 * np.pi)


def _source_or_name(channel: Channel, name: str) -> str:
    """Return the source (device) of a channel, or the name of the channel if it has no source."""
    return channel.source or name
