"""Generators of plans: static, steps, chirp and all for one thruster on the bench, and random missions for a boat.

The bench plans follow the thesis, 4.2: a sequence of progressively increasing steps, and two chirps, one of each sign.
A mission combines the excitation that a diagnosis needs:

- steady speeds forward and in reverse,
- turns at several speeds,
- independent commands of both thrusters over their whole range,
- oscillation about rest and about forward speed.
"""

from __future__ import annotations

import numpy as np

from seatrial.daq.config import RAMP_DT, STATIC, FloatArray, Mission, Segment

STATIC_S = 10.0  # s at rest before and after, for the tare
HOLD_S = 1.8  # s for which each step is held: long enough for the dynamics of the shaft
REST_S = 3.0  # s of zero between two excitations, so that the shaft stops and the water calms
MISSION_STATIC_S = 5.0  # s at rest at the start and at the end of a mission
MISSION_KINDS = ("mixed", "steps", "zigzag", "chirp")
BENCH_KINDS = ("static", "steps", "chirp", "all")


class SegmentBuilder:
    """Builder of the segments of a mission, one after the other.

    Attributes
    ----------
    t : float
        Time [s] at which the next segment starts.
    segments : list of Segment
        Segments so far.
    """

    def __init__(self, n_thrusters: int) -> None:
        """Start at time 0 without segments. ``n_thrusters`` is the number of thrusters of the mission."""
        self.t = 0.0
        self.segments: list[Segment] = []
        self._n_thrusters = n_thrusters

    def add(self, name: str, durations: list[float], rows: list[list[float]]) -> None:
        """Append a segment of commands, each of which holds for a given time, and advance `t` to the segment's end.

        Parameters
        ----------
        name : str
            Name of the segment.
        durations : list of float
            Time [s] for which each row of commands holds, one for each row. Times of changes are rounded to ms.
        rows : list of list of float
            Rows of commands: one command for each thruster in each row, which is rounded to 1e-6. If it is empty, no
            segment is appended.
        """
        if not rows:
            return
        edges = np.round(self.t + np.concatenate([[0.0], np.cumsum(durations)]), 3)
        self.segments.append(Segment(name, edges[:-1], np.array(rows, dtype=np.float64).round(6)))
        self.t = float(edges[-1])

    def rest(self, name: str, seconds: float) -> None:
        """Append a segment named ``name`` of ``seconds`` [s], in which all commands are zero, and advance `t`."""
        self.add(name, [seconds], [[0.0] * self._n_thrusters])

    def wave(self, name: str, seconds: float, n: FloatArray) -> None:
        """Append a segment named ``name`` of sampled commands that last ``seconds`` [s] in all, and advance `t`.

        ``n`` has the commands (n_samples, n_thrusters). All samples hold for the same time.
        """
        self.add(name, [seconds / len(n)] * len(n), n.tolist())


def step_levels(n_max: float, count: int) -> list[float]:
    """Return the commands of a staircase that rises in steps to ``n_max`` and falls again, without zero.

    Parameters
    ----------
    n_max : float
        Largest command, as a fraction of full command.
    count : int
        Number of equal steps from zero to ``n_max``.

    Returns
    -------
    list of float
        ``2 count + 3`` commands. The first step is divided into three equal smaller ones, going up and going down,
        because the edge of the thruster's dead zone lies there. ``n_max`` occurs once.
    """
    first = n_max / count
    up = [first / 3, 2 * first / 3, *(first * k for k in range(1, count + 1))]
    return up + up[-2::-1]


def sweep_phase(seconds: float, f0: float, f1: float) -> tuple[FloatArray, FloatArray]:
    """Return the times and the phase of a sweep whose frequency changes linearly with time.

    Parameters
    ----------
    seconds : float
        Length [s].
    f0, f1 : float
        First and last frequency [Hz].

    Returns
    -------
    tuple of Array (n_samples,)
        Times [s] from 0, 40 ms apart (`RAMP_DT`), and phase [rad] from 0. There is at least one sample.
    """
    t = np.arange(max(1, round(seconds / RAMP_DT)), dtype=np.float64) * RAMP_DT
    return t, 2 * np.pi * (f0 * t + (f1 - f0) * t**2 / (2 * seconds))


def chirp_rows(sign: float, n_max: float, seconds: float, f0: float = 0.05, f1: float = 1.5) -> FloatArray:
    """Return the commands of a frequency sweep (chirp) of one thruster and of one sign, 40 ms apart (`RAMP_DT`).

    Parameters
    ----------
    sign : float
        1 forward, -1 in reverse.
    n_max : float
        Largest command, as a fraction of full command.
    seconds : float
        Length [s].
    f0, f1 : float
        First and last frequency [Hz].

    Returns
    -------
    Array (n_samples, 1)
        Commands ``sign * n_max * (1 - cos(phase)) / 2``, whose frequency changes linearly with time. The sweep starts
        at zero. With the default frequencies it crosses the thruster's dead zone slowly at first.
    """
    _, phase = sweep_phase(seconds, f0, f1)
    return (sign * n_max * (0.5 - 0.5 * np.cos(phase)))[:, None]


def bench_plan(
    kind: str, thruster: str, n_max: float = 0.9, hold_s: float = HOLD_S, chirp_s: float = 20.0, count: int = 6
) -> Mission:
    """Return the plan of a bench run with one thruster, which starts and ends with 10 s at rest.

    After each staircase and each chirp the command is zero for 3 s.

    Parameters
    ----------
    kind : str
        "static" (only 10 s at rest), "steps" (staircases forward and in reverse), "chirp" (frequency sweeps forward and
        in reverse) or "all" (steps, then chirps: about two minutes).
    thruster : str
        Name of the thruster.
    n_max : float
        Largest command, as a fraction of full command.
    hold_s : float
        Time [s] for which each step of a staircase is held.
    chirp_s : float
        Length [s] of each chirp.
    count : int
        Number of equal steps of a staircase up to ``n_max``.

    Raises
    ------
    ValueError
        If ``kind`` is none of these.
    """
    if kind not in BENCH_KINDS:
        raise ValueError(f"there is no bench run {kind!r}; use one of {', '.join(BENCH_KINDS)}")
    builder = SegmentBuilder(1)
    builder.rest(STATIC, STATIC_S)
    if kind in ("steps", "all"):
        for sign, word in ((1.0, "forward"), (-1.0, "reverse")):
            levels = step_levels(n_max, count)
            builder.add(f"steps {word}", [hold_s] * len(levels), [[sign * level] for level in levels])
            builder.rest("rest", REST_S)
    if kind in ("chirp", "all"):
        for sign, word in ((1.0, "forward"), (-1.0, "reverse")):
            builder.wave(f"chirp {word}", chirp_s, chirp_rows(sign, n_max, chirp_s))
            builder.rest("rest", REST_S)
    if kind != "static":
        builder.rest(STATIC, STATIC_S)
    made = f"bench plan {kind}, n_max {n_max:g}"
    return Mission(
        name=f"bench {kind} {thruster}",
        kind="mission" if kind == "all" else kind,
        thrusters=(thruster,),
        segments=tuple(builder.segments),
        end=builder.t,
        n_max=n_max,
        made_by=made,
    )


def make_mission(
    kind: str, seconds: float, seed: int, thrusters: tuple[str, str] = ("left", "right"), n_max: float = 1.0
) -> Mission:
    """Return a random mission for two thrusters. The same seed gives the same mission.

    Parameters
    ----------
    kind : str
        "steps" (surge steps, then random steps of both thrusters), "zigzag", "chirp", or "mixed" (four equal parts:
        surge steps, zigzag, random steps, chirps).
    seconds : float
        Duration [s], more than 10 s. It includes 5 s of zero thrust at the start and 5 s at the end.
    seed : int
        Seed of the random generator.
    thrusters : tuple of str
        Names of the left and the right thruster.
    n_max : float
        Largest command, as a fraction of full command. Most random commands scale with it, and none is beyond it.

    Raises
    ------
    ValueError
        If ``kind`` is none of these.
    """
    if kind not in MISSION_KINDS:
        raise ValueError(f"there is no mission kind {kind!r}; use one of {', '.join(MISSION_KINDS)}")
    rng = np.random.default_rng(seed)
    generators = {
        "mixed": (_surge_steps, _zigzag, _random_steps, _chirps),
        "steps": (_surge_steps, _random_steps),
        "zigzag": (_zigzag,),
        "chirp": (_chirps,),
    }[kind]
    builder = SegmentBuilder(2)
    builder.rest(STATIC, MISSION_STATIC_S)
    share = (seconds - 2 * MISSION_STATIC_S) / len(generators)
    for k, generate in enumerate(generators, start=1):
        generate(builder, rng, MISSION_STATIC_S + share * k, n_max)
    builder.rest(STATIC, MISSION_STATIC_S)
    return Mission(
        name=f"{kind}, seed {seed}",
        kind="mission",
        thrusters=thrusters,
        segments=tuple(builder.segments),
        end=builder.t,
        n_max=n_max,
        made_by=(
            f"seatrial mission generate --kind {kind} --seconds {seconds:g} --seed {seed}"
            f" --n-max {n_max:g} --thrusters {','.join(thrusters)}"
        ),
        seed=seed,
    )


def _left_right_commands(common: float, difference: float, n_max: float) -> list[float]:
    """Return the commands of the left and the right thruster: ``common + difference`` and ``common - difference``.

    Both are clipped to [-n_max, n_max].
    """
    return [float(np.clip(common + side * difference, -n_max, n_max)) for side in (1.0, -1.0)]


def _cut_to_duration(durations: list[float], until: float) -> list[float]:
    """Return the durations [s] with the last one changed so that their sum is ``until`` [s]. The list is not empty."""
    return [*durations[:-1], durations[-1] - (sum(durations) - until)]


def _surge_steps(builder: SegmentBuilder, rng: np.random.Generator, stop: float, n_max: float) -> None:
    """Append a segment of surge steps up to time ``stop`` [s]: steady commands of 5 to 12 s, forward, reverse and zero.

    The segment is appended to ``builder``, which is changed in place. ``rng`` draws the order of the commands, up to
    ``n_max``, and their durations; the last one is cut at ``stop``. The commands of both thrusters differ by at most
    0.3, whatever ``n_max`` is. The steps contain information about the surge damping.
    """
    levels = np.array([0.2, 0.35, 0.5, 0.65, 0.8, 1.0, -0.5, 0.0, -0.3]) * n_max
    durations: list[float] = []
    rows: list[list[float]] = []
    while sum(durations) < stop - builder.t:
        # All levels in random order, then all again: independent draws could leave out reverse in a short mission.
        for level in rng.permutation(levels):
            if sum(durations) < stop - builder.t:
                rows.append(_left_right_commands(level, rng.choice([-1, 1]) * rng.uniform(0.02, 0.15), n_max))
                durations.append(float(rng.uniform(5.0, 12.0)))
    builder.add("surge steps", _cut_to_duration(durations, stop - builder.t), rows)


def _zigzag(builder: SegmentBuilder, rng: np.random.Generator, stop: float, n_max: float) -> None:
    """Append a zigzag segment up to time ``stop`` [s]: turns of 4 to 9 s to alternate sides, at several speeds.

    The segment is appended to ``builder``, which is changed in place. ``rng`` draws the mean command (0.3 to 0.85 times
    ``n_max``), the difference to it, the duration and the first side anew after every four turns. Commands are clipped
    to ``n_max``; the last turn is cut at ``stop``. Turns contain information about sway damping, yaw damping and their
    coupling.
    """
    durations: list[float] = []
    rows: list[list[float]] = []
    while sum(durations) < stop - builder.t:
        speed, difference = rng.choice([0.3, 0.5, 0.7, 0.85]) * n_max, rng.uniform(0.1, 0.35)
        half, side = float(rng.uniform(4.0, 9.0)), float(rng.choice([-1, 1]))
        for _ in range(4):
            if sum(durations) < stop - builder.t:
                rows.append(_left_right_commands(speed, side * difference, n_max))
                durations.append(half)
                side = -side
    builder.add("zigzag", _cut_to_duration(durations, stop - builder.t), rows)


def _random_steps(builder: SegmentBuilder, rng: np.random.Generator, stop: float, n_max: float) -> None:
    """Append a segment of independent random steps of both thrusters, of 1 to 5 s, up to time ``stop`` [s].

    The segment is appended to ``builder``, which is changed in place. ``rng`` draws the commands, from -0.7 to 1 times
    ``n_max``, and the durations; the last step is cut at ``stop``. The steps contain information about differences and
    interaction of the thrusters, reverse thrust and the dead zone.
    """
    durations: list[float] = []
    rows: list[list[float]] = []
    while sum(durations) < stop - builder.t:
        rows.append((rng.uniform(-0.7, 1.0, 2) * n_max).tolist())
        durations.append(float(rng.uniform(1.0, 5.0)))
    builder.add("random steps", _cut_to_duration(durations, stop - builder.t), rows)


def _chirps(builder: SegmentBuilder, rng: np.random.Generator, stop: float, n_max: float) -> None:
    """Append chirp segments of 15 to 30 s up to time ``stop`` [s]: oscillations about rest or about forward speed.

    The segments are appended to ``builder``, which is changed in place. ``rng`` draws mean, amplitude, duration and
    kind; the commands are clipped to ``n_max``. The last chirp is cut at ``stop``; none is added if 40 ms or less
    remain. In a chirp the difference of the commands ("yaw") or their mean ("surge", the left command 0.14 above the
    right one) oscillates with a frequency that rises from 0.05 to 0.5 Hz. In "both" each command oscillates alone, the
    right one with 1.37 times this frequency. Chirps contain information about lags, delays and added masses.
    """
    number = 0
    while stop - builder.t > RAMP_DT:
        number += 1
        seconds = min(float(rng.uniform(15.0, 30.0)), stop - builder.t)
        _, phase = sweep_phase(seconds, 0.05, 0.5)
        mean, amplitude = rng.choice([0.0, 0.4, 0.6]) * n_max, rng.uniform(0.2, 0.4) * n_max
        swing = amplitude * np.sin(phase)
        axis = int(rng.integers(3))
        if axis == 0:
            n, word = np.stack([mean + swing, mean - swing], 1), "yaw"
        elif axis == 1:
            n, word = np.stack([mean + swing + 0.07, mean + swing - 0.07], 1), "surge"
        else:
            n, word = np.stack([mean + swing, mean + amplitude * np.cos(1.37 * phase)], 1), "both"
        builder.wave(f"chirp {number} {word}", seconds, np.clip(n, -n_max, n_max))
