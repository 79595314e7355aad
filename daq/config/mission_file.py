"""Reader and writer of mission.toml: set-points over time, limits and provenance (docs/formats/mission.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import tomlkit

from seatrial.daq.config.toml_reader import TomlTable, parse_toml, read_text
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.files import write_output

FORMAT = "seatrial-mission 1"
KINDS = ("mission", "static", "steps", "chirp")
STATIC = "static"  # name of segments at rest; they serve to measure the load cell's zero and the sensors' noise
MAX_RAMP_ROWS = 1_000_000  # 11 h of ramps; a slew limit that needs more is a typing error
RAMP_DT = 0.04  # s, between the set-points of a ramp by the slew limit; equal to that of the rows of a chirp
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Segment:
    """Named segment of a mission, such as "static" or "steps up": rows of thruster commands over time.

    The commands of a row hold from the time of the row to the time of the next row.

    Attributes
    ----------
    name : str
        Name of the segment. Several segments of a mission may have the same name.
    t : Array (K,)
        Times of the rows since the start of the mission [s].
    n : Array (K, n_thrusters)
        Commands, -1..1: 1 is full forward. The columns are in the order of `Mission.thrusters`.
    """

    name: str
    t: FloatArray
    n: FloatArray

    def __eq__(self, other: object) -> bool:
        """Return whether the other object is a segment with the same name, times and commands.

        The default of dataclasses raises an error for arrays.
        """
        return (
            isinstance(other, Segment)
            and self.name == other.name
            and np.array_equal(self.t, other.t)
            and np.array_equal(self.n, other.n)
        )

    def __hash__(self) -> int:
        """Return a hash of a segment, from its name and the bytes of its times and commands."""
        return hash((self.name, self.t.tobytes(), self.n.tobytes()))


AREA_TOLERANCE = 0.01  # m: a mission file has the predicted track in cm
ENOUGH_INSIDE = 0.95  # share of the sampled boats inside the area, below which a mission has advice


class OperationArea(NamedTuple):
    """Area of operation that a mission was designed for, with its place relative to the start of the boat.

    Attributes
    ----------
    size : tuple of float
        Extent in the direction north and in the direction east [m].
    corner : tuple of float
        South-west corner, north and east of the start [m].
    inside : float
        Share of the simulated boats that stay in the area during the whole mission, 0..1.
    """

    size: tuple[float, float]
    corner: tuple[float, float]
    inside: float

    def contains(self, x: FloatArray, y: FloatArray) -> bool:
        """Return whether a track with the positions ``x`` and ``y`` (K,) north and east of the start [m] is inside.

        Positions up to `AREA_TOLERANCE` outside count as inside.
        """
        low = np.array(self.corner)[:, None] - AREA_TOLERANCE
        high = np.array(self.corner)[:, None] + np.array(self.size)[:, None] + AREA_TOLERANCE
        track = np.array([x, y])
        return bool(((track >= low) & (track <= high)).all())

    def is_kept(self, x: FloatArray, y: FloatArray) -> bool:
        """Return whether the track of the nominal boat is inside, and enough of the sampled boats are.

        ``x`` and ``y`` (K,) are the positions of the nominal boat, north and east of the start [m].
        """
        return self.contains(x, y) and self.inside >= ENOUGH_INSIDE


def area_sentence(area: OperationArea, x: FloatArray, y: FloatArray) -> str:
    """Return the sentences that say whether a predicted track keeps the area, and what to do if boats leave it.

    Parameters
    ----------
    area : OperationArea
        The area, with its place and the share of the simulated boats that stay in it.
    x, y : array (K,)
        Positions of the nominal boat, north and east of the start [m].
    """
    nominal = "stays" if area.contains(x, y) else "does not stay"
    (north, east), (south, west) = area.size, (-v for v in area.corner)
    text = (
        f"The nominal boat {nominal} in the area of {north:g} m north by {east:g} m east, and "
        f"{100 * area.inside:.0f} % of the boats with sampled parameters do, if the start is {south:.0f} m north and "
        f"{west:.0f} m east of its south-west corner."
    )
    if area.is_kept(x, y):
        return text
    return f"{text} To keep more of them inside, give a shorter --duration, a smaller --n-max or a larger --area."


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted track of a designed mission, from simulations of boats with uncertain parameters.

    Attributes
    ----------
    model : str
        Name or path of the boat model that was simulated, such as "vehicle/model.toml".
    t : Array (K,)
        Times since the start of the mission [s].
    x, y : Array (K,)
        Position north and east of the start [m]. The boat starts with heading north.
    radius : Array (K,)
        Distance from the track [m] within which 95 % of the simulated boats were.
    errors_before : Mapping
        Standard error of each model parameter before the mission, by name and in the unit of the parameter. Parameters
        with an unknown error are missing.
    area : OperationArea or None
        Area of operation of the design; None without one.
    """

    model: str
    t: FloatArray
    x: FloatArray
    y: FloatArray
    radius: FloatArray
    errors_before: Mapping[str, float] = field(default_factory=dict)
    area: OperationArea | None = None

    def __eq__(self, other: object) -> bool:
        """Return whether the other object is a prediction with the same model, numbers and standard errors."""
        return isinstance(other, Prediction) and self._content() == other._content()

    def __hash__(self) -> int:
        """Return a hash of a predicted track, from the name of its model and its positions `x` and `y`."""
        return hash((self.model, self.x.tobytes(), self.y.tobytes()))

    def _content(self) -> tuple[object, ...]:
        """Return all fields of a predicted track as lists and dictionaries, which `==` can compare."""
        arrays = (self.t.tolist(), self.x.tolist(), self.y.tolist(), self.radius.tolist())
        return (self.model, *arrays, dict(self.errors_before), self.area)


class TrackExtent(NamedTuple):
    """Area that a predicted track needs, including its 95 % band.

    Attributes
    ----------
    north, east : float
        Extent in the direction north and in the direction east [m].
    away : float
        Largest distance from the start [m].
    """

    north: float
    east: float
    away: float

    def __str__(self) -> str:
        """Return the area in words, for the terminal and for the page of a design."""
        return f"{self.north:.0f} m north by {self.east:.0f} m east, at most {self.away:.0f} m from the start"


def track_extent(x: FloatArray, y: FloatArray, radius: FloatArray) -> TrackExtent | None:
    """Return the area that a predicted track needs; None if it has no points, or if its band has no limit.

    ``x`` and ``y`` (K,) are the positions north and east of the start [m]. ``radius`` (K,) is the half width of the
    band [m] (`Prediction`).
    """
    if not len(x) or not np.isfinite([x, y, radius]).all():
        return None
    north, east = (float(np.max(z + radius) - np.min(z - radius)) for z in (x, y))
    return TrackExtent(north, east, float(np.max(np.hypot(x - x[0], y - y[0]) + radius)))


@dataclass(frozen=True)
class Mission:
    """Content of one mission.toml. Times are in s from the start of the mission, commands are normalised to -1..1.

    Attributes
    ----------
    name
        Name of the mission.
    kind
        One of KINDS: "mission", "static", "steps" or "chirp".
    thrusters
        Names of the thrusters, in the order of the columns of the commands.
    segments
        Segments in the order of time.
    end
        Time [s] from which thrust is zero.
    n_max
        Largest allowed magnitude of a command, 0..1.
    slew_per_s
        Largest rate of change of a command [1/s]; inf: no limit.
    made_by
        Command line that generated the mission; may be empty.
    seed
        Seed of the random numbers; None if no random numbers were used.
    predicted_errors
        Predicted standard error of each model parameter after the mission, by name and in the unit of the parameter.
    prediction
        Predicted track; None if the mission was not designed by a model.
    """

    name: str
    kind: str
    thrusters: tuple[str, ...]
    segments: tuple[Segment, ...]
    end: float
    n_max: float = 1.0
    slew_per_s: float = math.inf
    made_by: str = ""
    seed: int | None = None
    predicted_errors: Mapping[str, float] = field(default_factory=dict)
    prediction: Prediction | None = None

    def segment_times(self) -> list[tuple[float, float, str]]:
        """Return start [s], end [s] and name of each segment in order.

        Times count from the start of the mission. A segment ends at the start of the next one, the last one at `end`.
        """
        begins = [float(segment.t[0]) for segment in self.segments]
        ends = [*begins[1:], self.end]
        return [(t0, t1, s.name) for t0, t1, s in zip(begins, ends, self.segments, strict=True)]

    def setpoints(self) -> tuple[FloatArray, FloatArray]:
        """Return the commands of all segments with the slew limit applied, and a final row of zeros at `end`.

        Rows at or after `end` are left out.

        Returns
        -------
        t : Array (K,)
            Times since the start of the mission [s].
        n : Array (K, n_thrusters)
            Commands, -1..1.

        Notes
        -----
        The slew limit does not apply to the final row: thrust has to end at the same time, whatever the last command.
        """
        t = np.concatenate([segment.t for segment in self.segments])
        n = np.concatenate([segment.n for segment in self.segments])
        if math.isfinite(self.slew_per_s):
            t, n = _limit_slew(t, n, self.end, self.slew_per_s)
        keep = t < self.end
        zero = np.zeros((1, len(self.thrusters)))
        return np.append(t[keep], self.end), np.concatenate([n[keep], zero])


def _limit_slew(t: FloatArray, n: FloatArray, end: float, slew: float) -> tuple[FloatArray, FloatArray]:
    """Return times and commands of a mission in which each step is replaced by a ramp of at most `slew` [1/s].

    The first ramp starts from zero. The rows of a ramp are 40 ms apart (RAMP_DT), and its first row, at the time of the
    command, has the change of up to 40 ms. A ramp ends when it reaches its command, or unfinished at the time of
    the next row. Each thruster has its own ramp.

    Parameters
    ----------
    t : Array (K,)
        Times of the rows [s].
    n : Array (K, n_thrusters)
        Commands, -1..1.
    end : float
        End of the mission [s], at which the last ramp ends at the latest.
    slew : float
        Largest rate of change of a command [1/s].

    Returns
    -------
    tuple of Array
        Times (M,) [s] and commands (M, n_thrusters), with M >= K.
    """
    now, last_t = np.zeros(n.shape[1]), -math.inf
    out_t: list[float] = []
    out_n: list[FloatArray] = []
    for k, target in enumerate(n):
        until = t[k + 1] if k + 1 < len(t) else end
        t_row = float(t[k])
        while True:
            step = slew * min(RAMP_DT, t_row - last_t)
            now = now + np.clip(target - now, -step, step)
            out_t.append(t_row)
            out_n.append(now)
            last_t, t_row = t_row, t_row + RAMP_DT
            if np.array_equal(now, target) or t_row >= until - 1e-9:
                break
    return np.array(out_t), np.array(out_n)


def load_mission(path: Path) -> Mission:
    """Read a mission.toml, check it and return its mission.

    Raises
    ------
    SeatrialError
        If the file cannot be read or is not a valid mission. The message names file and key.
    """
    return parse_mission(read_text(path), path)


def parse_mission(text: str, source: Path | str) -> Mission:
    """Check the text of a mission.toml and return its mission.

    Parameters
    ----------
    text
        Text of the file.
    source
        Path of the file, with which error messages begin. The file itself is not read.

    Raises
    ------
    SeatrialError
        If the text is not a valid mission. The message names the key.
    """
    root = parse_toml(text, source)
    root.text("format", choices=(FORMAT,))
    root.text("hold", "zero", choices=("zero",))
    thrusters = _read_thruster_names(root, "thrusters")
    provenance = root.table("provenance") or TomlTable({}, root.source)
    limits = root.table("limits") or TomlTable({}, root.source)
    end = root.table("end")
    if end is None:
        hint = root.misspelling_hint("end")
        raise root.error("end", f"missing; add a table [end] with t, the time [s] from which thrust is zero{hint}")
    mission = Mission(
        name=root.line("name"),
        kind=root.text("kind", choices=KINDS),
        thrusters=thrusters,
        segments=tuple(_read_segment(table, len(thrusters)) for table in root.tables("segment")),
        end=end.number("t"),
        n_max=limits.number("n_max", 1.0, high=1.0, positive=True),
        slew_per_s=limits.number("slew_per_s", positive=True) if limits.has("slew_per_s") else math.inf,
        made_by=provenance.line("made_by", ""),
        seed=provenance.integer("seed") if provenance.has("seed") else None,
        predicted_errors=_read_predicted_errors(provenance.table("predicted_errors")),
        prediction=parse_prediction(root.table("prediction")),
    )
    for table in (root, provenance, limits, end):
        table.done()
    _check_order_and_size(mission, root)
    return mission


def _pop_list_items(table: TomlTable, key: str) -> TomlTable:
    """Remove the list `key` from a table, and return its items as a table with the keys `key[1]`, `key[2]`, ...

    The given table is changed, so that its `done` does not report the list as an unknown key. With the new keys an
    error message names the item of the list. A missing or empty list, or a value that is no list, raises SeatrialError.
    """
    value = table.values.pop(key, None)
    if not isinstance(value, list) or not value:
        raise table.error(key, f"must be a list with at least one item{table.misspelling_hint(key)}")
    return TomlTable({f"{key}[{i}]": item for i, item in enumerate(value, start=1)}, table.source, table.where)


def _read_thruster_names(root: TomlTable, key: str) -> tuple[str, ...]:
    """Return the names of thrusters in the list `key` of the root table of a mission.toml, in their order.

    The list is removed from the table. A missing or empty list, an item that is not printable text, and a name that
    appears twice raise SeatrialError.
    """
    items = _pop_list_items(root, key)
    names = tuple(items.line(item) for item in items.values)
    if len(set(names)) < len(names):
        raise root.error(key, "names a thruster twice; give each thruster once")
    return names


def _read_predicted_errors(table: TomlTable | None) -> dict[str, float]:
    """Return the standard errors in the table [provenance.predicted_errors] of a mission.toml, by name of parameter.

    The dictionary is empty if `table` is None. A value that is not a finite number raises SeatrialError.
    """
    return {} if table is None else table.named_numbers()


def _read_segment(table: TomlTable, n_thrusters: int) -> Segment:
    """Read one [[segment]] table of a mission.toml, in which each row has `n_thrusters` commands.

    The segment must have at least one row, one row per time, strictly ascending times, and finite numbers; otherwise,
    and for an unknown key, SeatrialError is raised. The range of the commands and the first time are not checked here.
    """
    name, t = table.line("name"), np.array(table.numbers("t"), dtype=np.float64)
    items = _pop_list_items(table, "n")
    n = np.array([items.numbers(item, length=n_thrusters) for item in items.values], dtype=np.float64)
    table.done()
    if len(t) != len(n):
        text = f"has {counted(len(n), 'list')} of commands for {counted(len(t), 'time')} in t; give one list per time"
        raise table.error("n", text)
    falling = np.flatnonzero(np.diff(t) <= 0)
    if falling.size:
        k = int(falling[0]) + 1
        raise table.error(
            f"t[{k + 1}]", f"{t[k]:g} does not come after {t[k - 1]:g}; write the times in ascending order"
        )
    return Segment(name, t, n)


def parse_prediction(table: TomlTable | None) -> Prediction | None:
    """Read the table [prediction] of a mission.toml. Return None if there is no table.

    The lists of the track must have the length of `t`, at least one. Missing standard errors (`errors_before`) give an
    empty mapping. The area (`area`) is optional. It is not checked that the times ascend.

    Raises
    ------
    SeatrialError
        If a key is missing, unknown or has a wrong value.
    """
    if table is None:
        return None
    t = np.array(table.numbers("t"), dtype=np.float64)
    if not t.size:
        raise table.error("t", "must have at least one time; design the mission again, or leave out [prediction]")
    x, y, radius = (np.array(table.numbers(key, length=len(t)), dtype=np.float64) for key in ("x", "y", "radius"))
    errors_table = table.table("errors_before")
    errors = {} if errors_table is None else errors_table.named_numbers()
    area, area_table = None, table.table("area")
    if area_table is not None:
        (north, east), (first, second) = (area_table.numbers(key, length=2) for key in ("size", "corner"))
        area = OperationArea((north, east), (first, second), area_table.number("inside", low=0.0, high=1.0))
        area_table.done()
    prediction = Prediction(table.line("model"), t, x, y, radius, errors, area)
    table.done()
    return prediction


def _check_order_and_size(mission: Mission, root: TomlTable) -> None:
    """Raise SeatrialError if the segments of a mission do not follow each other, or if a value is beyond its limit.

    The checks are: there is at least one segment, the first time is not negative, each segment begins after the last
    time of the one before, the mission ends after the last time, no command exceeds `n_max` in magnitude, and the ramps
    of the slew limit can have at most 1,000,000 rows (MAX_RAMP_ROWS). `root` is the root table of the file; error
    messages name the file and the key by it.
    """
    if not mission.segments:
        raise root.error("segment", "missing; a mission needs at least one [[segment]]: add one")
    last = -math.inf
    for i, segment in enumerate(mission.segments, start=1):
        if segment.t[0] < 0.0 or segment.t[0] <= last:
            before = "the last time of the segment before" if i > 1 else "the start of the mission"
            text = f"{segment.t[0]:g} must come after {max(last, 0.0):g} s, {before}; give a later time"
            raise root.error(f"segment[{i}].t[1]", text)
        last = float(segment.t[-1])
        beyond = np.argwhere(np.abs(segment.n) > mission.n_max)
        if beyond.size:
            row, column = beyond[0]
            key, value = f"segment[{i}].n[{row + 1}]", segment.n[row, column]
            raise root.error(
                key, f"{value:g} is beyond n_max = {mission.n_max:g} in [limits]; lower it, or raise n_max"
            )
    if not mission.end > last:
        raise root.error("end.t", f"{mission.end:g} must come after the last command at {last:g} s; give a later time")
    times = np.append(np.concatenate([segment.t for segment in mission.segments]), mission.end)
    longest = 2.0 * mission.n_max / mission.slew_per_s  # s, from full reverse to full forward
    if (n_rows := float(np.minimum(np.diff(times), longest).sum()) / RAMP_DT) > MAX_RAMP_ROWS:
        raise root.error(
            "limits.slew_per_s",
            f"{mission.slew_per_s:g} per second makes ramps of up to {n_rows:.0f} set-points, "
            f"more than {MAX_RAMP_ROWS}; give a faster slew_per_s",
        )


def save_mission(mission: Mission, path: Path, force: bool = True) -> None:
    """Write a mission to the file `path` in the format of mission.toml.

    Parameters
    ----------
    mission
        The mission.
    path
        The file.
    force
        Whether an existing file is replaced.

    Raises
    ------
    SeatrialError
        If the file cannot be written, or if it exists and `force` is false.
    """
    try:
        write_output(path, dump_mission(mission), force)
    except OSError as error:
        raise SeatrialError(f"{path}: {error.strerror}; the mission was not saved: give another path") from error


def dump_mission(mission: Mission) -> str:
    """Return the text of a mission.toml, from which `parse_mission` returns an equal mission if the mission is valid.

    Numbers are written without rounding. The mission is not checked here.
    """
    quoted = _toml_string
    lines = [
        f"format = {quoted(FORMAT)}",
        f"name = {quoted(mission.name)}",
        f"kind = {quoted(mission.kind)}",
        f"thrusters = [{', '.join(quoted(name) for name in mission.thrusters)}]",
        'hold = "zero"  # a command holds until the next',
        "",
        "[provenance]",
        f"made_by = {quoted(mission.made_by)}",
    ]
    if mission.seed is not None:
        lines.append(f"seed = {mission.seed}")
    errors = ", ".join(f"{quoted(key)} = {float(value)!r}" for key, value in mission.predicted_errors.items())
    lines += [f"predicted_errors = {{{errors}}}", "", "[limits]", f"n_max = {float(mission.n_max)!r}"]
    if math.isfinite(mission.slew_per_s):
        lines.append(f"slew_per_s = {float(mission.slew_per_s)!r}")
    lines += dump_prediction(mission.prediction) if mission.prediction is not None else []
    for segment in mission.segments:
        lines += ["", "[[segment]]", f"name = {quoted(segment.name)}"]
        lines += [f"t = {_toml_array(segment.t)}", "n = ["]
        lines += [f"    {_toml_array(row)}," for row in segment.n]
        lines.append("]")
    lines += ["", "[end]", f"t = {float(mission.end)!r}  # zero thrust from here on", ""]
    return "\n".join(lines)


def dump_prediction(prediction: Prediction) -> list[str]:
    """Return the lines of the table [prediction] of a mission.toml, from a predicted track. The first line is empty."""
    rows = {"t": prediction.t, "x": prediction.x, "y": prediction.y, "radius": prediction.radius}
    errors = ", ".join(f"{tomlkit.item(k).as_string()} = {float(v)!r}" for k, v in prediction.errors_before.items())
    lines = ["", "[prediction]", f"model = {tomlkit.item(prediction.model).as_string()}"]
    lines += [f"{key} = [{', '.join(repr(v) for v in values.tolist())}]" for key, values in rows.items()]
    lines.append(f"errors_before = {{{errors}}}")
    if (area := prediction.area) is not None:
        size, corner = ([float(v) for v in pair] for pair in (area.size, area.corner))
        lines.append(f"area = {{size = {size!r}, corner = {corner!r}, inside = {float(area.inside)!r}}}")
    return lines


def _toml_string(text: str) -> str:
    """Return a text as a TOML string in quotes, with special characters escaped."""
    return tomlkit.item(text).as_string()


def _toml_array(values: FloatArray) -> str:
    """Return numbers (K,) as the text of a TOML array, such as "[0.0, 0.5]". The numbers are not rounded."""
    return "[" + ", ".join(repr(value) for value in values.tolist()) + "]"
