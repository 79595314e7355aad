"""Description of a mission as text and as data: segments, the range of each command, predictions of its design."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from seatrial.daq.config import FloatArray, Mission, Prediction, area_sentence, track_extent


def describe_mission(mission: Mission) -> str:
    """Return the description of a mission that `seatrial mission show` prints, as lines in one text.

    It contains name, duration, limits and origin of the mission, and a line for each segment. For a mission of an
    experiment design it also contains the predicted standard errors of parameters and the predicted track. A slew limit
    is named only if the mission has one, and an origin that is not given is "unknown".
    """
    slew = f", slew_per_s {mission.slew_per_s:g}" if np.isfinite(mission.slew_per_s) else ""
    lines = [
        f"{mission.name} ({mission.kind}), {mission.end:g} s, n_max {mission.n_max:g}{slew}",
        f"made by: {mission.made_by or 'unknown'}",
        *describe_segments(mission),
    ]
    expected = mission.prediction
    lines += describe_errors(mission.predicted_errors, expected.errors_before if expected else {})
    lines += describe_track(expected) if expected else []
    return "\n".join(lines)


def mission_content(mission: Mission) -> dict[str, Any]:
    """Return the description of a mission as data, which `seatrial mission show --json` prints.

    Returns
    -------
    dict
        ``name``, ``kind``, ``thrusters``, ``seconds`` (duration), ``n_max``, ``slew_per_s`` (infinite: no limit),
        ``made_by`` and ``seed``; ``segments`` with ``name``, ``begin``, ``end`` [s] and by thruster the smallest and
        the largest command; ``predicted_errors`` and ``errors_before`` by parameter; ``track``, the extent of the
        predicted track [m], None without one; and ``area``, the area of operation with its ``size``, its ``corner``
        from the start [m], the share ``inside`` of the simulated boats that stay in it, and ``nominal_inside``, None
        without one.
    """
    t, n = mission.setpoints()
    expected = mission.prediction
    segments = [
        {
            "name": name,
            "begin": begin,
            "end": end,
            "commands": {x: command_range(t, n[:, k], begin, end) for k, x in enumerate(mission.thrusters)},
        }
        for begin, end, name in mission.segment_times()
    ]
    track = track_extent(expected.x, expected.y, expected.radius) if expected else None
    return {
        "name": mission.name,
        "kind": mission.kind,
        "thrusters": mission.thrusters,
        "seconds": mission.end,
        "n_max": mission.n_max,
        "slew_per_s": mission.slew_per_s,
        "made_by": mission.made_by,
        "seed": mission.seed,
        "segments": segments,
        "predicted_errors": dict(mission.predicted_errors),
        "errors_before": dict(expected.errors_before) if expected else {},
        "track": track._asdict() if track else None,
        "area": _area_content(expected) if expected else None,
    }


def _area_content(expected: Prediction) -> dict[str, Any] | None:
    """Return the area of operation of a predicted track as data (`mission_content`); None without an area."""
    area = expected.area
    return None if area is None else {**area._asdict(), "nominal_inside": area.contains(expected.x, expected.y)}


def largest_command_line(mission: Mission, external: bool = False) -> str:
    """Return the line that a run prints before its first command: thrusters, largest command and duration.

    The largest command is that of the set-points, with the slew limit applied. With ``external`` set-points, which come
    during the run, it is `n_max`, the limit of the mission.
    """
    names = counted_names(mission.thrusters)
    largest = mission.n_max if external else float(np.abs(mission.setpoints()[1]).max())
    if largest == 0.0:
        return f"{mission.name}: {names} at rest, without a command, for {mission.end:g} s"
    return f"{mission.name}: {names} up to n = {largest:.3g} of full command, for {mission.end:g} s"


def counted_names(thrusters: Sequence[str]) -> str:
    """Return the names of thrusters after the word "thruster" or "thrusters", such as ``thrusters left and right``."""
    if len(thrusters) == 1:
        return f"thruster {thrusters[0]}"
    return f"thrusters {', '.join(thrusters[:-1])} and {thrusters[-1]}"


def describe_segments(mission: Mission) -> list[str]:
    """Return the table of a mission's segments as lines of text, one for each segment after an empty line and a head.

    The columns are begin and end [s] of the segment, its name, and the smallest and largest command of each thruster,
    with the slew limit of the mission applied. A constant command is shown as one number.
    """
    t, n = mission.setpoints()
    names = max(len("segment"), *(len(name) for _, _, name in mission.segment_times()))
    head = "".join(f"  {'n_cmd_' + thruster:>14}" for thruster in mission.thrusters)
    lines = ["", f"  {'time [s]':<17}  {'segment':<{names}}{head}"]
    for begin, end, name in mission.segment_times():
        ranges = (_format_range(*command_range(t, column, begin, end)) for column in n.T)
        lines.append(f"  {begin:7.1f} - {end:7.1f}  {name:<{names}}" + "".join(f"  {text:>14}" for text in ranges))
    return lines


def _format_range(low: float, high: float) -> str:
    """Return the range of commands from ``low`` to ``high`` as text, such as "-0.50 to +0.50".

    If both are equal, the text is one number.
    """
    return f"{low:+.2f}" if low == high else f"{low:+.2f} to {high:+.2f}"


def command_range(t: FloatArray, n: FloatArray, begin: float, end: float) -> tuple[float, float]:
    """Return the smallest and the largest command of one thruster in an interval of time.

    Parameters
    ----------
    t : Array (n_rows,)
        Times [s], ascending, from which each command holds until the next one. Before the first time the command is
        zero.
    n : Array (n_rows,)
        Commands.
    begin, end : float
        The interval [begin, end) [s].

    Returns
    -------
    tuple of two floats
        Smallest and largest command in the interval. The command that already holds at ``begin`` counts too.
    """
    first, last = np.searchsorted(t, begin, side="right") - 1, np.searchsorted(t, end, side="left")
    held = n[max(first, 0) : max(last, 1)]
    if first < 0:
        held = np.append(held if t[0] < end else held[:0], 0.0)
    return float(held.min()), float(held.max())


def describe_errors(after: Mapping[str, float], before: Mapping[str, float]) -> list[str]:
    """Return lines of text with the standard error of each model parameter that is predicted for a mission.

    An empty line and a heading come first.

    Parameters
    ----------
    after : Mapping
        Predicted standard error after the mission, by name of the parameter. If it is empty, no lines are returned.
    before : Mapping
        Standard error before the mission, by name of the parameter. A parameter without one has a dash. If it is empty,
        the column is left out.
    """
    if not after:
        return []
    if not before:
        return ["", "predicted standard errors after this mission", *(f"  {n:<10} {e:>9.3g}" for n, e in after.items())]
    lines = ["", "predicted standard errors before and after this mission", f"  {'':<10} {'before':>9} {'after':>9}"]
    for name, error in after.items():
        earlier = f"{before[name]:.3g}" if name in before else "-"
        lines.append(f"  {name:<10} {earlier:>9} {error:>9.3g}")
    return lines


def describe_track(predicted: Prediction) -> list[str]:
    """Return lines of text with the space that the predicted track of a mission takes, and with its area of operation.

    An empty line comes first. A track without points gives an empty list. The space is that of the band
    (`track_extent`). If the mission was designed for an area, a line says whether the track keeps it.
    """
    extent = track_extent(predicted.x, predicted.y, predicted.radius)
    lines = [] if extent is None else ["", f"predicted track with its band (95 %): {extent}; one boat needs less"]
    if predicted.area is not None:
        lines += ([] if lines else [""]) + [area_sentence(predicted.area, predicted.x, predicted.y)]
    return lines
