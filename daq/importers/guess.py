"""The command `seatrial import --guess`: a map of a source with the recognised signals, and a comment for each caveat.

Theory of operation. The tables of the source give candidates: by the type of a message, or by the names and values of
columns. For each signal the candidate with the lowest rank is written as a line of the map. The other candidates, and
columns that were not recognised, follow as comments.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import tomllib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import group_held_signals, held_signals, is_sampled_slower, supply_line
from seatrial.daq.errors import SeatrialError, UnknownName, first_names
from seatrial.daq.importers.bench_table import COMMAND, SHAFT, bench_candidates
from seatrial.daq.importers.clocks import DATES, Clock, clock_of, has_named_times, row_seconds
from seatrial.daq.importers.import_map import GEOGRAPHIC
from seatrial.daq.importers.input_hold import input_hold
from seatrial.daq.importers.recognise import (
    CAVEATS,
    NAMES,
    OUTPUT,
    PULSE_RANGE,
    PULSE_REST,
    PULSES,
    SET_POINTS,
    SETPOINT,
    SIDES,
    UNCHOSEN_RANK,
    Candidate,
    MapSignal,
    Name,
    drive,
    drive_words,
    message_candidates,
    named_commands,
    pulse_keys,
    quantity,
    read_name,
    read_nested_name,
    resting_pulse,
    unmeasured_parts,
    without_unit,
)
from seatrial.daq.importers.run_files import (
    FileOutline,
    RunFiles,
    files_of_folder,
    find_runs,
    is_run_folder,
    match_pattern,
    name_of_folder,
    require_sources,
    tables_of_folder,
)
from seatrial.daq.importers.sources import source_kind, text_head
from seatrial.daq.importers.table import Column, SourceOptions, Table
from seatrial.daq.importers.text_table import has_decimal_commas, sniff_style
from seatrial.daq.importers.units import UNITS
from seatrial.daq.log import LOG_FORMAT, open_log

THRUSTERS = ("drive", "command")  # groups of commands and shaft speeds
EFFORT = "effort"  # word of the columns with the efforts of joints (JointState)
COMMAND_WORDS = {"cmd", "cmds", "command", "commands"}  # in the topic of commands to joints
PAIRS = ("n_left", "n_right"), ("n_cmd_left", "n_cmd_right"), ("f_left", "f_right")
MOTION = ("x", "vx", "u", "psi", "r", "speed")
FORCES = {"X": "N", "N": "Nm"}  # units of surge force and yaw moment, by their SNAME letters
LETTERS = {"X": "surge force", "N": "yaw moment"}
STEERING, THROTTLE, LEFT_THROTTLE, RIGHT_THROTTLE = 26.0, 70.0, 73.0, 74.0  # SERVOn_FUNCTION of ArduPilot
FUNCTIONS = {
    STEERING: "steering",
    THROTTLE: "throttle",
    LEFT_THROTTLE: "throttle left",
    RIGHT_THROTTLE: "throttle right",
}
PULSE_US = (("MIN", 1100.0), ("TRIM", 1500.0), ("MAX", 1900.0))  # us; defaults of SERVOn_MIN, _TRIM and _MAX
# Topics, types and frames of ROS that use north, east, down or forward, starboard, down
_NED = re.compile(r"(?i)(?<![a-z])(ned|frd)(?![a-z])|px4_msgs|seatrial_msgs")
SCALARS = ("Float64", "Float32", "Float64Stamped", "Float32Stamped", "Scalar")  # only the topic names the quantity
LEAST_LARGEST_COMMAND = 0.3  # of a source, from which its largest shaft speed shows full speed
MOST_NAMED = 3  # files of a shared map that its first line names
MOST_KEPT_BYTES = 100_000_000  # of the files whose tables a guess keeps; as text, they are several times as large
MOST_LISTED = 12  # columns that were not recognised and are listed as comments
UNKNOWN_CDEG = 65535  # an unknown heading in MAVLink (hdg)
SHARES_OF_FULL = (0.2, 1.5)  # of a given number at full speed: usual sizes of the largest number of a source
FEWEST_ZEROS = 10  # rows; a measured signal that is 0 in so many, and in all others, is not measured
TURN = 6.6  # rad; slightly more than a whole turn
Clocks = Mapping[int, Clock]  # clock of each table, by the id of the table
BOATS = {10, 11, 12}  # MAV_TYPE: rover (ArduPilot's boats too), boat, submarine


class Guess(NamedTuple):
    """Import map that was guessed from the source files of a run.

    Attributes
    ----------
    text : str
        Text of the map, in TOML.
    problem : str
        Reason why no fit is possible with the map; "" if a fit should be possible.
    full : dict of str to float
        Number of the source that becomes 1, by signal, for signals whose scale is guessed from their largest number, or
        follows from a given number.
    unrecognised : sequence of str
        Columns of numbers that were not recognised.
    run : RunFiles
        The source files.
    assumed : sequence of str
        A line on each assumption about which files belong together, the same for all maps of one call.
    """

    text: str
    problem: str
    full: Mapping[str, float]
    unrecognised: Sequence[str]
    run: RunFiles
    assumed: Sequence[str]


class _Sources(NamedTuple):
    """Sources of a guess, with what is the same for the maps of all runs.

    Attributes
    ----------
    paths : sequence of Path
        Files and folders that the user gave.
    runs : sequence of RunFiles
        Runs that they have.
    reader : _Reader
        Reader of the files.
    folder : Path or None
        Folder in which the map will be stored; None for the current folder.
    known : dict of str to float
        Number of the source that becomes 1, by signal, where the user knows it.
    assumed : sequence of str
        Lines on assumptions about the runs.
    """

    paths: Sequence[Path]
    runs: Sequence[RunFiles]
    reader: _Reader
    folder: Path | None
    known: Mapping[str, float]
    assumed: Sequence[str]

    @property
    def is_merged(self) -> bool:
        """Whether the map needs [[file]] tables: a run has several files, or is alone in a folder with other tables."""
        return any(len(run.paths) > 1 for run in self.runs) or any(
            has_more and len(runs) == 1 for runs, has_more in self._runs_of_folders()
        )

    @property
    def to_import(self) -> list[Path]:
        """The files and folders that an import by the map takes.

        Of a folder with several runs of one file each, and with files of no run, they are the files of the runs.
        """
        given = list(self.paths)
        for runs, has_more in self._runs_of_folders() if not self.is_merged else ():
            if has_more:
                at = given.index(runs[0].source)
                given[at : at + 1] = [path for run in runs for path in run.paths]
        return given

    def _runs_of_folders(self) -> list[tuple[list[RunFiles], bool]]:
        """Return the runs of each folder that was given, and whether the folder has tables of no run."""
        used = {path for run in self.runs for path in run.paths}
        of_folder: dict[Path, list[RunFiles]] = {}
        for run in self.runs:
            if run.source.is_dir() and run.source not in run.paths:
                of_folder.setdefault(run.source, []).append(run)
        return [(runs, not used.issuperset(tables_of_folder(folder))) for folder, runs in of_folder.items()]


class _ReadFile(NamedTuple):
    """Source file of a run, as it is read for a guess.

    Attributes
    ----------
    path : Path
        The file.
    kind : str
        Name of the kind of source, for example "csv" or "ros".
    options : SourceOptions
        Options of the reader, which the map needs too.
    tables : list of Table
        Tables of the file.
    """

    path: Path
    kind: str
    options: SourceOptions
    tables: list[Table]


def guess_maps(
    paths: Sequence[Path],
    dbc: Path | None = None,
    folder: Path | None = None,
    known: Mapping[str, float] | None = None,
) -> list[Guess]:
    """Guess the import map of each run of source files; a scale that is guessed from numbers is the same in all.

    It is that of the largest number of all files, so that equal speeds stay equal. A file is a run, and so is a folder
    that is no bag of ROS. Files of different columns whose times overlap are one run (`find_runs`).

    Parameters
    ----------
    paths
        Source files, folders of ROS bags, and folders with the files of a run.
    dbc
        Database of the messages of a CAN log.
    folder
        Folder in which the map will be stored, by default the current folder. The map names the DBC relative to it.
    known
        Number of the source that becomes 1, by signal, where the user knows it.

    Returns
    -------
    list of Guess
        The maps, in the order of the runs. The first is the map that the runs share, if their files are alike.

    Raises
    ------
    SeatrialError
        As of `guess_map`, or if no file of a folder can be read. A name in ``known`` that no source has as a signal
        with a guessed scale is an error too (UnknownName).
    """
    known, reader = known or {}, _Reader(dbc)
    if len(paths) == 1 and not is_run_folder(paths[0]):
        require_sources(paths)
        runs, assumed = [_run_of_file(paths[0])], list[str]()
    else:
        runs, assumed = find_runs(paths, lambda path: _outline(reader.read(path)))
    of_first = set(runs[0].kinds)
    assumed += [
        f"{run.source}: has other columns than {runs[0].source}, so this map is not for it; guess its map alone"
        for run in runs
        if not of_first & set(run.kinds)
    ]
    sources = _Sources(paths, runs, reader, folder, known, assumed)
    found = [_guess_of_run(run, sources) for run in runs]
    scaled = dict.fromkeys(name for guess in found for name in guess.full)
    if unknown := [name for name in known if name not in scaled]:
        raise UnknownName(
            f"{first_names(unknown, 5)}: no signal whose full speed is guessed; these are: "
            f"{', '.join(scaled) or 'none'}"
        )
    if len(found) < 2:
        return found
    full: dict[str, float] = {}
    for guess in found:
        for name, top in guess.full.items():
            if name not in known:
                full[name] = max(top, full.get(name, 0.0))
    counts = Counter(name for guess in found for name in guess.full)
    return [_guess_of_run(run, sources, full, counts) for run in runs] if full else found


def guess_map(path: Path, dbc: Path | None = None) -> Guess:
    """Guess the import map of a source file: which of its columns are which signals, in which units.

    Parameters
    ----------
    path
        The source file, or the folder of a ROS bag.
    dbc
        Database of the messages of a CAN log.

    Returns
    -------
    Guess
        The text of the map, and the reason why no fit is possible with it ("" if a fit should be possible).

    Raises
    ------
    SeatrialError
        If the source cannot be read, is already a seatrial log, or is a text without a table of numbers, or with the
        comma as delimiter and as decimal mark; also if `dbc` is given for a source that is no CAN log.
    """
    run = _run_of_file(path)
    return _guess_of_run(run, _Sources((path,), (run,), _Reader(dbc), None, {}, ()))


def _run_of_file(path: Path) -> RunFiles:
    """Return the run of a single file."""
    return RunFiles(path.stem, (path,), (0,), path)


def _outline(file: _ReadFile) -> FileOutline:
    """Return the columns and the times of a source file."""
    columns, times = set[tuple[str, str]](), list[Column]()
    for table in file.tables:
        clock = clock_of(table)
        columns |= {(table.topic, name) for name in table.names if name not in (clock.column, clock.date)}
        t = row_seconds(table, clock)
        if t is not None and np.isfinite(t).any():
            times.append(t[np.isfinite(t)])
    span = (min(float(t.min()) for t in times), max(float(t.max()) for t in times)) if times else None
    return FileOutline(file.path, frozenset(columns), span)


class _Reader:
    """Reader of the source files of one guess, which keeps the tables of files up to 100 MB in all.

    The runs, the signals and the common scale of several files need the same tables.

    Parameters
    ----------
    dbc
        Database of the messages of CAN logs; None without one.
    """

    def __init__(self, dbc: Path | None) -> None:
        """Begin without files."""
        self.dbc = dbc
        self._kept: dict[Path, _ReadFile] = {}
        self._free = MOST_KEPT_BYTES

    def read(self, path: Path) -> _ReadFile:
        """Return the tables of a source file. Raise SeatrialError as `guess_map` does."""
        if path in self._kept:
            return self._kept[path]
        file = _read_file(path, self.dbc)
        parts = path.rglob("*") if path.is_dir() else [path]
        size = sum(part.stat().st_size for part in parts if part.is_file())
        # The first files are kept. All files are read in turn, so that the latest ones would never be found again.
        if size <= self._free:
            self._kept[path] = file
            self._free -= size
        return file


def _read_file(path: Path, dbc: Path | None) -> _ReadFile:
    """Read the tables of a source file, a CAN log with the database `dbc`. Raise SeatrialError as `guess_map` does."""
    kind = source_kind(path)
    if kind.name == "ros" and _is_log(path):
        raise SeatrialError(f"{path}: is a seatrial log and needs no import; check, ident and export read it directly")
    options = SourceOptions(dbc=dbc if kind.name == "can" else None)
    if kind.name == "csv":
        style = sniff_style(path, text_head(path))
        if (style is None or (style.delimiter == "," and style.columns)) and has_decimal_commas(text_head(path)):
            raise SeatrialError(
                f"{path}: the comma is both the delimiter and the decimal mark; save it again with ; as delimiter"
            )
        if style is None:
            raise SeatrialError(f"{path}: no table of numbers found in this text; write the import map by hand")
        options = SourceOptions(replace(style, nan="drop", time_order="drop"))  # as in the guessed map
    tables = [part for table in kind.read(path, options) if table.names for part in _by_own_times(table)]
    return _ReadFile(path, kind.name, options, tables)


def _guess_of_run(
    run: RunFiles,
    sources: _Sources,
    full: Mapping[str, float] | None = None,
    n_files: Mapping[str, int] | None = None,
) -> Guess:
    """Guess the import map of the files of one run.

    ``full`` has the number of the source that becomes 1, by signal, for signals whose scale is guessed from numbers.
    Other signals, and all signals by default, have their largest number in this run. ``n_files`` is the number of files
    with each of these signals, which the map names.
    """
    if sources.reader.dbc is not None and not any(source_kind(path).name == "can" for path in run.paths):
        raise SeatrialError(f"{run.source}: is not a CAN log (candump, .asc, .blf); leave out --dbc")
    files = [sources.reader.read(path) for path in run.paths]
    # the parameters of an autopilot are those of the first table
    tables = sorted((table for file in files for table in file.tables), key=lambda table: not table.parameters)
    clocks = {id(table): clock_of(table) for table in tables}
    candidates = [_with_full_speed(c, full or {}, sources.known) for c in _candidates(files, clocks)]
    of_ros = {id(table) for file in files if file.kind == "ros" for table in file.tables}
    candidates = [_with_unit_caveats(_with_frame_key(c) if id(c.table) in of_ros else c) for c in candidates]
    parts = [
        (
            file,
            _main_clock([c for c in candidates if _is_of(c.table, file)], {id(t): clocks[id(t)] for t in file.tables}),
        )
        for file in files
    ]
    mains = {id(table): main for file, main in parts for table in file.tables}
    silent, measured = list[Candidate](), list[Candidate]()
    for c in candidates:
        (silent if _is_always_zero(c) else measured).append(c)
    taken, lines = _chosen_signals(measured, clocks, mains, n_files or {})
    problem = _missing_for_fit(taken, tables)
    unrecognised = _unrecognised_columns(tables, candidates, clocks)
    empty = [file for file, _ in parts if len(files) > 1 and not _has_signals(file, lines)]
    text = _head_lines(sources, [file.path for file in empty])
    for kind, (file, main) in zip(run.kinds, parts, strict=True):
        own = [c for c in candidates if _is_of(c.table, file)]
        unnamed = [(table, column) for table, column in unrecognised if _is_of(table, file)]
        if file in empty:
            text += [f"# not in the map, as no signal was recognised: {file.path.name}", *_unrecognised_lines(unnamed)]
            continue
        if sources.is_merged:
            text += ["", "[[file]]", f"match = {_toml_text(_pattern(kind, sources.runs))}"]
        if file.kind == "ros":
            text.append('frame = "ENU"  # REP-103: east, north, up; forward, left, up; or else "NED"')
        if file.options.dbc is not None:
            place = os.path.relpath(file.options.dbc, sources.folder or Path())
            text.append(f"can = {{ dbc = {_toml_text(Path(place).as_posix())} }}")
        text += _style_line(file.options, file.kind) + _time_lines(file.tables, own, clocks, main)
        text += [f"# caveat: {table.full_remark}" for table in file.tables if table.full_remark]
        text += [line for table in file.tables for line in _not_measured_lines(table)]
        text += [_always_zero_line(c) for c in silent if _is_of(c.table, file)]
        text += [line for table in file.tables for line in _length_lines(table, clocks[id(table)], main)]
        text += [f"# caveat: {line}" for line in _held_signal_comments(own, taken, clocks)]
        text += ["signal = [", *lines.of(file.tables), *_unrecognised_lines(unnamed), "]"]
    # without a shaft speed the result is a static curve, which has no table of the power
    used = supply_line(signal.name for signal in taken) if any(signal.name == SHAFT for signal in taken) else ""
    text += [*([""] if sources.is_merged else []), *_boat_lines(taken), *([f"# {used}"] if used else [])]
    text += [f"# no fit: {problem}"] if problem else []
    tops = {signal.name: signal.full for signal in taken if signal.full}
    names = [column for _, column in unrecognised]
    return Guess("\n".join(text).rstrip("\n") + "\n", problem, tops, names, run, sources.assumed)


def _is_of(table: Table, file: _ReadFile) -> bool:
    """Return whether a table is one of a file."""
    return any(table is own for own in file.tables)


def _has_signals(file: _ReadFile, lines: _SignalLines) -> bool:
    """Return whether a signal of a file was chosen for the map."""
    return any(id(table) in lines.chosen for table in file.tables)


def _pattern(kind: int, runs: Sequence[RunFiles]) -> str:
    """Return the pattern of the names of the files of a kind in all runs. It matches no other file of their folders."""
    own = [path for run in runs for k, path in zip(run.kinds, run.paths, strict=True) if k == kind]
    others = {path for run in runs for path in run.paths}
    others |= {path for run in runs if is_run_folder(run.source) for path in files_of_folder(run.source)}
    return match_pattern(own, sorted(others.difference(own)))


def _head_lines(sources: _Sources, unused: Sequence[Path]) -> list[str]:
    """Return the first lines of a guessed map: the command, what was assumed, the format and the name.

    ``unused`` are files without a signal, which the import refuses unless it gets their folder.
    """
    usable = [path for path in sources.to_import if path not in unused]
    guessed, more = _words_of_paths(sources.paths), len(sources.paths) - MOST_NAMED
    and_more = f" and {more} more" if more > 0 else ""
    # a command with some of the names would import these alone
    args, of_files = ("FILE...", f" of {guessed}{and_more}") if more > 0 else (guessed, "")
    to_import, of_all = (args, " with all of them") if more > 0 else (_words_of_paths(usable), "")
    if more <= 0 and len(usable) > MOST_NAMED:
        to_import, of_all = "FILE...", f" with the {len(usable)} files that are not left out"
    if more > 0 and len(usable) < len(sources.paths):
        of_all += f" except {first_names([path.name for path in unused], MOST_NAMED)}"
    origins = [run.source if run.source.is_dir() else None for run in sources.runs if len(run.paths) > 1]
    if len(set(origins)) < len(origins):  # several runs of several files in one place: the import needs a folder each
        to_import, of_all = "FOLDER...", " with a folder of each run"
    stems = ", ".join(name_of_folder(path) if path.is_dir() else path.stem for path in sources.paths[:MOST_NAMED])
    return [
        f"# From `seatrial import --guess {args}`{of_files}. Check each caveat, then run `seatrial import MAP "
        f"{to_import}`{of_all}.",
        *(f"# assumed: {line}" for line in sources.assumed),
        'format = "seatrial-import 1"',
        f"name = {_toml_text(stems + and_more)}",
    ]


def _words_of_paths(paths: Sequence[Path]) -> str:
    """Return paths as words of a command, of many the first: as given, unless a path is long, to copy the command."""
    words = [path.name if path.is_absolute() else shlex.quote(path.as_posix()) for path in paths[:MOST_NAMED]]
    return " ".join(words)


def _candidates(files: Sequence[_ReadFile], clocks: Clocks) -> list[Candidate]:
    """Return the candidates for signals of all files of a run, with the scales that follow from their numbers.

    `clocks` has the time column of each table, by the id of the table.
    """
    tables = [table for file in files for table in file.tables]
    drives: dict[frozenset[str], list[Column]] = {}  # by quantity: left and right get the same scale
    for table in tables:
        for column, _, words, values in _named_columns(table, clocks):
            if (
                drive_words(words) and without_unit(column) not in FORCES
            ):  # N may be north and must not affect the scale
                drives.setdefault(quantity(words), []).append(values)
    together = {words: np.concatenate(values) for words, values in drives.items()}
    benches = [c for t in tables if not t.kind for c in bench_candidates(t, row_seconds(t, clocks[id(t)]))]
    if benches:
        return _with_speeds_of_commands(_with_resting_pulses(benches))
    candidates = [c for t in tables for c in (*message_candidates(t), *_column_candidates(t, clocks, together))]
    candidates += [c for file in files for c in outputs(file.tables)]
    return _with_speeds_of_commands(_with_resting_pulses(named_commands(candidates)))


def _boat_lines(taken: Sequence[MapSignal]) -> list[str]:
    """Return comment lines that show the tables ``[geometry]`` and ``[scale]`` of an import map with example numbers.

    A source has no geometry and no thrust of the boat, so that the user has to give them. The list is empty if the map
    has no inputs of a left and a right thruster. It lacks ``[scale]`` if these inputs are forces.
    """
    inputs = {signal.name for signal in taken if 'role = "input"' in signal.extra}
    pairs = [name for name in ("n", "n_cmd", "f") if {f"{name}_left", f"{name}_right"} <= inputs]
    if not pairs:
        return []
    geometry = [
        "# What no file has: give your numbers in place of these examples, and remove the #. Otherwise masses are",
        "# ratios to the thrust, and the positions of the thrusters are built in.",
        "# [geometry]",
        "# y_left = -0.3   # thrusters to starboard of the middle [m]",
        "# y_right = 0.3",
        "# x_thrusters = -0.5  # ahead of the centre of gravity [m]: negative behind it",
        "# mass = 30.0     # weighed [kg], for a check of the result",
        "# length = 1.6    # of the hull [m], likewise",
        "# lever_arm_m = [0.1, 0.0, 0.0]  # GNSS antenna ahead of the centre of gravity, to starboard and down [m]",
        "# lever_arm_sd = 0.02  # its standard uncertainty [m]",
    ]
    thrust = [
        "# [scale]",
        "# ahead = 45.0    # thrust of one thruster at full command [N], and its size astern;",
        "# astern = 35.0   # if only the thrust ahead is known, leave the other one out",
        "# ahead_sd = 1.5  # standard uncertainty of each [N]",
        "# astern_sd = 1.5",
    ]
    return geometry + (thrust if pairs != ["f"] else [])


def _by_own_times(table: Table) -> list[Table]:
    """Divide a table of nested structs of equal lengths into those that have times of their own.

    Otherwise all would get the times of the first. A struct without times stays with the outer struct if this has
    times, or else with the first struct. Other tables are returned as they are.
    """
    if not table.topic or table.kind or table.t is not None:
        return [table]
    parts: dict[str, list[str]] = {}
    for name in table.names:
        parts.setdefault(name.rpartition(".")[0], []).append(name)
    timed = [part for part, names in parts.items() if has_named_times(_columns_of(table, names))]
    if len(timed) < 2:
        return [table]
    first = "" if "" in timed else timed[0]
    for part in [part for part in parts if part not in timed]:
        parts[first] += parts.pop(part)
    found = [_columns_of(table, parts[part]) for part in timed]
    return [found[0], *(replace(part, remark="", events=()) for part in found[1:])]


def _columns_of(table: Table, names: Collection[str]) -> Table:
    """Return a table with some of the columns of a table."""
    columns = {name: values for name, values in table.columns.items() if name in names}
    return replace(table, columns=columns, texts={name: cells for name, cells in table.texts.items() if name in names})


def _not_measured_lines(table: Table) -> list[str]:
    """Return a comment line for each part of a ROS Imu that is not measured and left out; none for other tables."""
    return [
        f"# not measured: {part} of {table.topic}, whose covariance begins with -1"
        for part, changes in unmeasured_parts(table).items()
        if not changes
    ]


def _is_always_zero(candidate: Candidate) -> bool:
    """Return whether the columns of measured signals are 0 in all of at least `FEWEST_ZEROS` (10) rows.

    Drivers write 0 for what they do not measure. A command may be zero in a whole log.
    """
    if any('role = "input"' in signal.extra for signal in candidate.signals):
        return False
    columns = [candidate.table.numbers(column) for signal in candidate.signals for column in signal.columns]
    known = [values[np.isfinite(values)] for values in columns]
    return all(values.size >= FEWEST_ZEROS and not values.any() for values in known)


def _always_zero_line(candidate: Candidate) -> str:
    """Return a comment line that names the columns of a candidate that is 0 in all rows."""
    columns = dict.fromkeys(column for signal in candidate.signals for column in signal.columns)
    of_topic = f" of {candidate.table.topic}" if candidate.table.topic else ""
    return f"# not measured: {first_names(list(columns), MOST_NAMED)}{of_topic}, 0 in the whole source"


def _length_lines(table: Table, clock: Clock, main: Clock) -> list[str]:
    """Return a comment line if a table has no times only because its columns have another length than the time column.

    The list is empty for other tables. ``clock`` is the time column of the table, and ``main`` that of the map.
    """
    if clock.column or table.t is not None or main.column not in table.lengths:
        return []
    n_times = table.lengths[main.column]
    return [
        f"# caveat: {first_names(table.names, MOST_NAMED)}: {len(table)} values, but {main.column!r} has {n_times}; "
        "they cannot be imported until they have the same number of values"
    ]


def _with_full_speed(candidate: Candidate, full: Mapping[str, float], known: Mapping[str, float]) -> Candidate:
    """Return a candidate whose signals with a guessed full speed have that of ``known`` or ``full``, by their names.

    Those of ``known`` are no guess. If the largest number of the source is far from a given one, a caveat says so: the
    given number is probably in another unit.
    """
    signals, caveats = [], [candidate.caveat] * bool(candidate.caveat)
    for s in candidate.signals:
        if s.full and s.name in known:
            share = s.full / known[s.name]
            if not SHARES_OF_FULL[0] < share < SHARES_OF_FULL[1]:
                caveats.append(
                    f"{s.name}: the largest number is {s.full:.4g}, {share:.2g} times the given {known[s.name]:.6g}; "
                    "give it in the unit of the source (1 rad/s is 9.55 rpm)"
                )
            signals.append(s._replace(full=known[s.name], at_command=0.0, is_given=True))
        else:
            signals.append(s._replace(full=full[s.name]) if s.full and s.name in full else s)
    return candidate._replace(signals=tuple(signals), caveat="; ".join(caveats))


def _with_speeds_of_commands(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Scale measured shaft speeds so that the largest of them belongs to the largest command of the source.

    A shaft is assumed to follow its command, which may be a number from -1 to 1, per cent or a pulse. Commands of which
    the largest is below 0.3 or reaches 1, and those whose own scale is guessed from their largest number, change
    nothing.
    """
    commands = [
        np.nanmax(np.abs(_as_imported(s, c.table.numbers(s.columns[0]))), initial=0.0)
        for c in candidates
        for s in c.signals
        if s.name.startswith("n_cmd_") and not s.full
    ]
    largest = max(commands, default=0.0)
    if not LEAST_LARGEST_COMMAND <= largest < 1.0:
        return list(candidates)
    return [
        c._replace(
            signals=tuple(
                s._replace(full=s.full / largest, at_command=largest)
                if s.full and s.name.startswith("n_") and 'hold = "linear"' in s.extra
                else s
                for s in c.signals
            )
        )
        for c in candidates
    ]


def _as_imported(signal: MapSignal, cells: Column) -> Column:
    """Return the values of a signal of one column in SI units, as an import of its cells (n,) by the map gives them.

    Cells that mark a missing value become NaN.
    """
    keys = tomllib.loads(f"keys = {{ {signal.extra} }}")["keys"]
    known = np.where(cells == keys.get("missing", np.nan), np.nan, cells)
    return np.asarray((keys.get("scale", 1.0) * known + keys.get("offset", 0.0)) * UNITS[signal.unit][1])


def _with_resting_pulses(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Scale pulses from the value at which their output rests in the source, and add a caveat about it.

    An output that does not show its rest has that of the other side. Without either it is 1500 us. Candidates without
    pulses, and those whose scale comes from parameters of the autopilot, stay as they are.
    """
    shown: dict[frozenset[str], list[tuple[float, float]]] = {}  # rest and share of each output, by quantity
    for c in candidates:
        outputs_of = [s for s in c.signals if s.extra.startswith(PULSES)]
        rests = [resting_pulse(c.table.numbers(s.columns[0])) for s in outputs_of]
        shown.setdefault(c.quantity, []).extend(rest for rest in rests if rest is not None)
    found = []
    for c in candidates:
        signals, caveats = [], []
        for signal in c.signals:
            if not signal.extra.startswith(PULSES):
                signals.append(signal)
                continue
            own = resting_pulse(c.table.numbers(signal.columns[0]))
            rest, share = own or max(shown[c.quantity], key=lambda r: r[1], default=(PULSE_REST, 0.0))
            signals.append(signal._replace(extra=signal.extra.replace(PULSES, pulse_keys(rest))))
            whose = "" if own else " on the other side"
            why = f" ({100.0 * share:.0f} % of the pulses{whose} have this value)" if share else ""
            ends = f"{rest - PULSE_RANGE:.6g} and {rest + PULSE_RANGE:.6g}"
            caveats.append(f"{rest:.6g} us is assumed to be rest{why}, {ends} us full astern and ahead")
        caveat = "; ".join(part for part in (*dict.fromkeys(caveats), c.caveat) if part)
        found.append(c._replace(signals=tuple(signals), caveat=caveat))
    return found


def _scale_remark(signal: MapSignal, n_files: int) -> str:
    """Return the remark on a scale at the end of the line of a signal: given by the user, or inferred from the data.

    The text is empty if the unit has the scale.
    """
    if not signal.full:
        return ""
    if signal.is_given:
        return f"  # scale: given, 1 / {signal.full:.6g}"
    of = "this file" if n_files == 1 else f"these {n_files} files"
    over = f" over its largest command, {signal.at_command:.3g}" if signal.at_command else ""
    return (
        f"  # scale: inferred, 1 / {signal.full:.6g}, the largest number of {of}{over}; better: 1 / (number at full "
        "speed), the same on both sides, in all files and in the log of the bench"
    )


def _is_log(path: Path) -> bool:
    """Return whether a file is a log of seatrial in the present format.

    The result is False if the file cannot be opened as a log, and for a log of another program.
    """
    try:
        with open_log(path) as log:
            return log.metadata.get("format") == LOG_FORMAT
    except SeatrialError:  # a bag of another format, or damaged: its own reader raises the error
        return False


def _toml_text(text: str) -> str:
    """Return a text in quotes, with the escapes of TOML, for a guessed import map.

    Letters that are not ASCII stay as they are.
    """
    return json.dumps(text, ensure_ascii=False)


def _style_line(options: SourceOptions, kind: str) -> list[str]:
    """Return the line `csv = ...` of a guessed import map, in a list; an empty list if the source is not a text table.

    `kind` is the kind of source, "csv" for a text table. The line has delimiter and decimal mark of the text in
    `options.style`. The line has encoding, lines to skip and names of columns only if they differ from the default. Its
    keys nan and time_order drop cells without a number and rows out of order.
    """
    if kind != "csv":
        return []
    style = options.style
    keys = [f"delimiter = {_toml_text(style.delimiter)}", f"decimal = {_toml_text(style.decimal)}"]
    if style.encoding != "utf-8-sig":
        keys.append(f"encoding = {_toml_text(style.encoding)}")
    if style.skip_rows:
        keys.append(f"skip_rows = {style.skip_rows}")
    if style.columns:
        keys.append(f"columns = [{', '.join(_toml_text(name) for name in style.columns)}]")
    return [f'csv = {{ {", ".join(keys)}, nan = "drop", time_order = "drop" }}']


# Times


def _main_clock(candidates: Sequence[Candidate], clocks: Clocks) -> Clock:
    """Return the time column, with its format, for the table [time] of a guessed import map.

    It is that of the first candidate whose table has one. Without such a candidate it is the first time column of any
    table, else a `Clock` with the column "". `clocks` has the time column of each table, by the id of the table.
    """
    found = [clocks[id(candidate.table)] for candidate in candidates]
    return next((clock for clock in (*found, *clocks.values()) if clock.column), Clock())


def _time_lines(tables: Sequence[Table], candidates: Sequence[Candidate], clocks: Clocks, main: Clock) -> list[str]:
    """Return the line `time = ...` of a guessed import map, after comments with caveats about time columns.

    The caveats are those of `main` and of the other time columns of tables with candidates. The line names the time
    column in `main`. The line has the rate of the rows (`rate_hz`) instead if the time stamps are coarser than the
    rows, and a guessed rate of 10 Hz without a time column. The list is empty if all tables have their own times, or
    without tables. `clocks` has the time column of each table, by the id of the table.
    """
    if not tables or all(table.t is not None for table in tables):
        return []
    if not main.column:
        return ["# caveat: no column of times found; the rate is a guess: correct it", "time = { rate_hz = 10.0 }"]
    caveats = [main.caveat] if main.caveat else []
    for table in (candidate.table for candidate in candidates):
        clock = clocks[id(table)]
        if clock.caveat and clock != main:
            place = f"{table.topic}, {clock.column!r}" if table.topic else repr(clock.column)
            caveats.append(f"{place}: {clock.caveat}")
    date = f", date = {_toml_text(main.date)}" if main.date else ""
    line = f"time = {{ column = {_toml_text(main.column)}, format = {_toml_text(main.form)}{date} }}"
    if main.rate:
        day = datetime.fromtimestamp(main.start, UTC).isoformat() if main.start > DATES[0] else ""
        origin = f', origin = "{day}"' if day else ""
        line = f"time = {{ rate_hz = {main.rate:.6g}{origin} }}  # instead of column = {_toml_text(main.column)}"
    return [*(f"# caveat: {caveat}" for caveat in dict.fromkeys(caveats)), line]


def _held_signal_comments(candidates: Sequence[Candidate], taken: Sequence[MapSignal], clocks: Clocks) -> Iterator[str]:
    """Yield a comment for each group of signals whose values the source repeats in each row until the next measurement.

    The comment has the names and the time between measurements. Only signals in `taken`, those chosen for the import
    map, are tested, if their rows have times. Inputs without a hold in the map are not tested, since their last value
    holds anyway, nor are commands that were sampled almost in each row. `clocks` has the time column of each table, by
    the id of the table.
    """
    tables: dict[tuple[int, bytes], tuple[Column, dict[str, Column]]] = {}
    sampled = set[str]()
    for candidate in candidates:
        t = row_seconds(candidate.table, clocks[id(candidate.table)])
        for signal in candidate.signals:
            holds = 'role = "input"' in signal.extra and "hold = " not in signal.extra
            if t is None or holds or not any(signal is chosen for chosen in taken):
                continue
            if 'hold = "sampled"' in signal.extra:
                sampled.add(signal.name)
            values = np.sum([candidate.table.numbers(column) for column in signal.columns], axis=0)
            known = np.isfinite(values) & np.isfinite(t)
            table = tables.setdefault((id(candidate.table), known.tobytes()), (t[known], {}))
            table[1][signal.name] = values[known]
    for t, signals in tables.values():
        found = held_signals(t, signals)
        left_out = {n: held for n, held in found.items() if n not in sampled or is_sampled_slower(held)}
        for names, held in group_held_signals(left_out):
            yield (
                f"{names}: held between measurements {held.rows * float(np.ptp(t)) / (len(t) - 1):.3g} s apart; "
                'the import leaves the repeats out (if each row is a measurement, give the signal repeats = "keep")'
            )


# Columns by their names


def _named_columns(table: Table, clocks: Clocks) -> Iterator[tuple[str, Name, frozenset[str], Column]]:
    """Yield (column, parsed name, words, values (n,)) for each column of numbers of a table.

    The words are those of the column. For messages, and for a column that is named by a side only (the field port of a
    struct cmd), they are also those of the topic. Tables with a type of messages yield no columns, except messages of a
    DBC, of a single number (not those of seatrial) and of joints (JointState). Topics of set-points yield no columns
    either. The column of times and columns of text are skipped. A message with a single number is named by its topic.
    `clocks` has the time column of each table, by the id of the table.
    """
    message = table.kind.rpartition("/")[2]
    is_scalar = message in SCALARS and not table.kind.startswith("seatrial_msgs/")
    is_named_by_topic = is_scalar or message == "JointState"
    if (table.kind not in ("", "dbc") and not is_named_by_topic) or SETPOINT.search(table.topic):
        return
    for column in table.names:
        if column == clocks[id(table)].column:
            continue
        try:
            values = table.numbers(column)
        except SeatrialError:
            continue
        unit = f" [{table.units[column]}]" if column in table.units else ""
        name = read_name(table.topic.rpartition("/")[2] if is_scalar else column + unit)
        if table.topic and not table.kind and not name.meaning:
            name = read_nested_name(column, unit) or name
        by_topic = is_named_by_topic or table.kind == "dbc" or name.words <= SIDES
        yield column, name, name.words | (read_name(table.topic).words if by_topic else frozenset()), values


def _column_candidates(table: Table, clocks: Clocks, together: Mapping[frozenset[str], Column]) -> Iterator[Candidate]:
    """Yield the signals that the names of a table's columns suggest, as candidates for a guessed import map.

    These are commands, shaft speeds and forces of thrusters, and the signals of the boat's motion. Tables with a type
    of messages yield nothing here, except messages of a DBC, of a single number and of joints. Of several columns with
    one meaning of motion, such as two headings, only the first counts. A column without a finite value is no thruster,
    except a force X or N. `together` has the numbers of the left and right columns of each quantity of thrusters, so
    that both sides get the same scale. `clocks` has the time column of each table, by the id of the table.
    """
    message = table.kind.rpartition("/")[2]
    names: dict[str, tuple[str, Name]] = {}
    numbers: dict[str, Column] = {}
    letters = {without_unit(column) for column in table.names}
    for column, name, words, values in _named_columns(table, clocks):
        numbers[column] = values
        letter = without_unit(column)
        if letter in FORCES or (letter == "E" and "N" in letters):
            stated = name.unit or name.no_unit
            if axis := _position_axis(letter, letters, stated):
                names.setdefault(axis, (column, name._replace(meaning=axis)))
            elif letter in FORCES:
                unit = stated if UNITS.get(stated, ("",))[0] == FORCES[letter] else FORCES[letter]
                caveat = "" if unit == stated else f"{letter} is assumed to be the {LETTERS[letter]} in {unit}"
                yield Candidate("force", 1, table, (MapSignal(letter, (column,), unit, "", 'role = "input"'),), caveat)
            continue
        both = together.get(quantity(words), values)
        is_joint = message == "JointState"
        if is_joint and EFFORT in words:
            if (effort := _effort_of_joint(words, values, both)) is not None:
                group, taken, caveat, rank = effort
                yield Candidate(group, rank, table, (taken._replace(columns=(column,)),), caveat, quantity(words))
            continue
        found = drive(words, both, name.unit) if np.isfinite(values).any() else None
        if found is not None and (not name.meaning or "velocity" in words) and (not is_joint or "velocity" in words):
            group, taken, caveat = found
            taken, hold_caveat = _with_hold(taken, row_seconds(table, clocks[id(table)]), values, words)
            caveat = "; ".join(part for part in (caveat, hold_caveat) if part)
            behind = is_joint + 2 * (is_joint and not _varies(values)) + bool(words & SET_POINTS)
            signals = (taken._replace(columns=(column,)),)
            yield Candidate(group, behind, table, signals, caveat, quantity(words))
        elif name.meaning and name.meaning not in names:
            names[name.meaning] = column, name
    yield from _motion_candidates(table, row_seconds(table, clocks[id(table)]), names, numbers)


def _varies(values: Column) -> bool:
    """Return whether the finite numbers among values (n,) differ."""
    known = values[np.isfinite(values)]
    return known.size > 0 and bool(np.ptp(known) > 0.0)


def _effort_of_joint(words: frozenset[str], values: Column, both: Column) -> tuple[str, MapSignal, str, int] | None:
    """Return the group, the signal without its column, the caveat and the rank of the effort of a thruster's joint.

    Parameters
    ----------
    words
        Words of the names of joint and topic.
    values
        Efforts of the joint (n,).
    both
        Efforts of the joints of both sides, which get the same scale.

    Returns
    -------
    tuple or None
        In a topic of commands, such as /thrusters/command, the effort is a command, ranked behind velocities that vary.
        In other topics, a force that is not chosen: ROS has no rule for the effort of a thruster. None if the joint is
        not that of a thruster, or if its effort does not vary.
    """
    of_thruster = words - {EFFORT}
    if not drive_words(of_thruster) or not _varies(values):
        return None
    is_command = bool(of_thruster & COMMAND_WORDS)
    found = drive(of_thruster, both, "" if is_command else "N")
    if found is None:
        return None
    group, signal, caveat = found
    text = "the effort of a joint in a topic of commands is assumed to be the command"
    if not is_command:
        text = (
            f"effort of a joint: {signal.name} in N if it is the thrust; give it the name of a command (n_left) and "
            "`scale` if it is one; the torque of a shaft is no input"
        )
    return group, signal, "; ".join(filter(None, (text, caveat))), 2 if is_command else UNCHOSEN_RANK


def _with_hold(taken: MapSignal, t: Column | None, values: Column, words: frozenset[str]) -> tuple[MapSignal, str]:
    """Add to an input of a guessed map its hold between rows ("linear" or "sampled"), judged by its values (n,).

    Return the input, and a caveat about the hold ("" if the hold is certain). An input whose values do not show the
    hold gets no key. The input is unchanged, without a caveat, if its times `t` (n,) [s] are None or it has a hold
    already. `words` are the words of its name: it may be a shaft speed only if "n" is among them and no word of a
    set-point.
    """
    if t is None or "hold = " in taken.extra:
        return taken, ""
    known = np.isfinite(values) & np.isfinite(t)
    found = input_hold(t[known], values[known], may_be_shaft="n" in words and not words & SET_POINTS)
    return _with_key(taken, f'hold = "{found.hold}"') if found.hold else taken, found.caveat


def _position_axis(letter: str, letters: Collection[str], stated: str) -> str:
    """Return "x" (north) or "y" (east) if a column named X, N or E (`letter`) is a position, "" if the column is none.

    Its unit `stated` in the file must be a length. Without a unit, X is a position if the table has a column Y and no
    N; N and E are positions if the table has both. `letters` are the names of all columns of the table.
    """
    beside = (letter == "X" and "Y" in letters and "N" not in letters) or (letter != "X" and {"N", "E"} <= set(letters))
    is_length = UNITS.get(stated, ("",))[0] == "m"
    return ("y" if letter == "E" else "x") if is_length or (beside and not stated) else ""


def _with_frame_key(candidate: Candidate) -> Candidate:
    """Return a candidate from a ROS bag, with the key frame = "NED" in its signals if their topic is in NED.

    The guessed map of a bag has frame = "ENU" for all signals without this key. A topic is in NED if its name, type or
    frame_id contains "ned" or "frd" as a word or is a message of PX4 or seatrial. So is a heading that is a single
    number, if the topic is named compass, heading or hdg. A heading or yaw rate that is a single number gets a caveat
    about its axes, except a compass. Candidates for thrusters never get the key, nor do signals made of latitude,
    longitude, speed or course, which are always in NED.
    """
    table, caveat = candidate.table, candidate.caveat
    is_ned = bool(_NED.search(f"{table.topic} {table.kind} {table.frame_id}"))
    if not is_ned and table.kind.rpartition("/")[2] in SCALARS:
        words, also = read_name(table.topic).words, ""
        if candidate.group == "heading" and words & {"compass", "heading", "hdg"}:
            is_ned = True
            also = "" if "compass" in words else 'assumed clockwise from north; if from east, give frame = "ENU"'
        elif candidate.group == "heading":
            also = 'assumed counter-clockwise from east, as in REP-103; if from north, give frame = "NED"'
        elif candidate.group == "rate":
            also = 'assumed positive to port, as in REP-103; if positive to starboard, give frame = "NED"'
        caveat = "; ".join(part for part in (caveat, also) if part)
    if candidate.group in (*THRUSTERS, "force") or not is_ned:
        return candidate._replace(caveat=caveat)
    ned = [s if s.make in GEOGRAPHIC else _with_key(s, 'frame = "NED"') for s in candidate.signals]
    return candidate._replace(signals=tuple(ned), caveat=caveat)


def _with_key(signal: MapSignal, key: str) -> MapSignal:
    """Return a signal of a guessed import map with a further key, as TOML text, for example 'frame = "NED"'.

    The key is appended to the further keys of the signal.
    """
    return signal._replace(extra=", ".join(part for part in (signal.extra, key) if part))


def _with_unit_caveats(candidate: Candidate) -> Candidate:
    """Add a caveat for each column whose name contains a unit that its signal cannot have, and return the candidate.

    The unit is ignored. The caveats are appended to the one that the candidate has. For example a heading cannot have
    the unit of a column "heading [m]".
    """
    columns = {column: read_name(column).no_unit for signal in candidate.signals for column in signal.columns}
    units = {signal.unit for signal in candidate.signals}
    caveats = [
        f"{text!r} in {column!r} is not a unit of this signal and is ignored"
        for column, text in columns.items()
        if text and text not in units
    ]
    return candidate._replace(caveat="; ".join(part for part in (candidate.caveat, *caveats) if part))


def _motion_candidates(
    table: Table, t: Column | None, names: dict[str, tuple[str, Name]], numbers: dict[str, Column]
) -> Iterator[Candidate]:
    """Yield the signals of position, velocity, acceleration, heading and yaw rate in a table, as candidates for a map.

    Parameters
    ----------
    table
        The table.
    t
        Times of its rows (n,) [s]; None if unknown.
    names
        Column and parsed name by the meaning of the column: "x", "lat", "psi", ...
        (`seatrial.daq.importers.recognise.NAMES`).
    numbers
        Values (n,) by column.

    Notes
    -----
    A position comes from x and y or from latitude and longitude, and a velocity from north and east components or from
    speed and course. If the table has both, both are yielded, and x and y, and the components, have the better rank. A
    speed without course is a signal of its own, unless there is a surge velocity. A latitude above 90 degrees gets a
    rank with which it is not chosen.
    """

    def pair(group: str, rank: int, a: str, b: str, unit: str, caveat: str = "") -> Iterator[Candidate]:
        """Yield a candidate with the signals `a` and `b`, for example "x" and "y", if the table has both of them.

        `group` is their quantity, for example "position". A lower `rank` is preferred. `unit` is the default for
        columns without a unit in their name. `caveat` is what is uncertain; "" if nothing is.
        """
        if a in names and b in names:
            taken = tuple(MapSignal(n, (names[n][0],), names[n][1].unit or unit) for n in (a, b))
            yield Candidate(group, rank, table, taken, caveat)

    capital = "x" in names and names["x"][0] == "X"
    yield from pair(
        "position", 0, "x", "y", "m", 'X is assumed to be a position; a force has unit = "N"' if capital else ""
    )
    if "lat" in names and "lon" in names:
        both = (names["lat"][0], names["lon"][0])
        top = float(np.nanmax(np.abs(numbers[both[0]]), initial=0.0))
        unit = names["lat"][1].unit or ("degE7" if top > 1e4 else "deg")
        extra = f'units = ["{unit}", "{unit}"]' if unit != "deg" else ""
        signals = (MapSignal("x", both, "", "north", extra), MapSignal("y", both, "", "east", extra))
        if unit == "deg" and top > 90.0:
            caveat = f"{top:.7g} is not a latitude in degrees; the format may be ddmm.mmmm"
            yield Candidate("position", UNCHOSEN_RANK, table, signals, caveat)
        else:
            yield Candidate("position", 1, table, signals)
    plain = names["vx"][1].plain if "vx" in names else ""
    unclear = plain in ("vel_x", "velocity_x", "speed_x")
    caveat = (
        "assumed to be velocities north and east; velocities forward and to starboard are u and v" if unclear else ""
    )
    yield from pair("velocity", 0, "vx", "vy", "m/s", caveat)
    yield from pair("body", 0, "u", "v", "m/s")
    known = all(names[n][1].unit for n in ("ax", "ay") if n in names)
    yield from pair(
        "acceleration", 0, "ax", "ay", "m/s2", "" if known else "accelerations are assumed to be in m/s2, not in g"
    )
    if "speed" in names:
        column, name = names["speed"]
        speed = name.unit or "m/s"
        top = float(np.nanmax(numbers[column], initial=0.0))
        caveat = "" if name.unit else f"a speed of at most {top:.3g} is assumed to be in m/s"
        if "course" in names:
            both = (column, names["course"][0])
            course, also = _angle_unit(names["course"][1], numbers[both[1]])
            units = f'units = ["{speed}", "{course}"]'
            signals = (
                MapSignal("vx", both, "", "velocity_north", units),
                MapSignal("vy", both, "", "velocity_east", units),
            )
            yield Candidate("velocity", 1, table, signals, "; ".join(part for part in (caveat, also) if part))
        elif "u" not in names:
            yield Candidate("body", 2, table, (MapSignal("speed", (column,), speed),), caveat)
    if "psi" in names:
        column, name = names["psi"]
        unknown = numbers[column] == UNKNOWN_CDEG
        numbers = {**numbers, column: np.where(unknown, np.nan, numbers[column])}
        unit, caveat = _angle_unit(name, numbers[column])
        extra = f", missing = {UNKNOWN_CDEG}" if unknown.any() else ""
        yield Candidate(
            "heading", 0, table, (MapSignal("psi", (column,), unit, "", f'angle = "unwrap"{extra}'),), caveat
        )
    if "r" in names:
        column, name = names["r"]
        unit, caveat = (name.unit, "") if name.unit else _rate_unit(t, numbers, column, names)
        yield Candidate("rate", 0, table, (MapSignal("r", (column,), unit),), caveat)


def _angle_unit(name: Name, values: Column) -> tuple[str, str]:
    """Return the unit of a heading or course (n,) and the caveat about it.

    The unit in the name of the column has priority. Otherwise the unit is "rad", "deg" or "cdeg". It is "rad" for
    values up to 6.6, or the unit in which the values jump by a whole turn (360 or 36000). Without such a jump it is
    "cdeg" if the first value is above 720, or else "deg". Without a finite value it is "rad".
    """
    # Unwrapped radians can be as large as degrees. Only a jump by a whole turn, or a first value above one, is clear.
    good = values[np.isfinite(values)]
    if name.unit or not len(good):
        return name.unit or "rad", ""
    top, first = float(np.max(np.abs(good))), abs(float(good[0]))
    if top <= TURN:
        return "rad", f"an angle of at most {top:.2f} is assumed to be in radians"
    jump = float(np.max(np.abs(np.diff(good)), initial=0.0))
    for unit, turn in (("deg", 360.0), ("cdeg", 36000.0)):
        if top <= 1.01 * turn and jump > 0.8 * turn:
            return unit, ""
    if first > 720.0:
        return "cdeg", f"an angle that begins at {first:.5g} is assumed to be in centidegrees"
    caveat = f"an angle of up to {top:.5g}, without a jump by a turn, is assumed to be in degrees"
    return "deg", "" if TURN < first <= 360.0 and top <= 720.0 else caveat


def _rate_unit(
    t: Column | None, numbers: dict[str, Column], column: str, names: dict[str, tuple[str, Name]]
) -> tuple[str, str]:
    """Return the unit of a yaw rate, "rad/s" or "deg/s", and the caveat about it.

    `column` is the column of the yaw rate, `numbers` has the values (n,) by column, and `names` the column and parsed
    name by meaning ("psi" is the heading). `t` (n,) are the times of the rows [s]. The unit is the one in which the yaw
    rate has about the size of the heading's derivative; an opposite sign of the two is a caveat. If there is no
    heading, no times, or no correlation of the two above 0.5, a yaw rate above 6 is in deg/s.
    """
    rate = numbers[column]
    if "psi" in names and t is not None:
        psi = numbers[names["psi"][0]]
        unit, guessed = _angle_unit(names["psi"][1], psi)
        factor = UNITS[unit][1]
        known = np.isfinite(t) & np.isfinite(psi) & np.isfinite(rate)
        step = np.diff(t[known])
        turned = np.diff(np.unwrap(factor * psi[known]))[step > 0.0] / step[step > 0.0]
        size = 0.5 * (rate[known][1:] + rate[known][:-1])[step > 0.0]
        with np.errstate(all="ignore"):
            follows = float(np.corrcoef(turned, size)[0, 1]) if len(size) > 1 else 0.0
        if abs(follows) > 0.5:
            slope = abs(follows) * np.std(turned) / np.std(size)  # 1 for rad/s, pi/180 for deg/s
            found = "deg/s" if slope < np.radians(1.0) ** 0.5 else "rad/s"
            caveats = [f"{found} if the heading is in {unit}"] * bool(guessed)
            caveats += ["it has the opposite sign of the heading's derivative; sign = -1 may be needed"] * (
                follows < 0.0
            )
            return found, "; ".join(caveats)
    top = float(np.nanmax(np.abs(rate), initial=0.0))
    unit = "deg/s" if top > 6.0 else "rad/s"
    return unit, f"a yaw rate of at most {top:.3g} is assumed to be in {unit}"


def outputs(tables: Sequence[Table]) -> Iterator[Candidate]:
    """Yield the outputs of an autopilot and the shaft speeds of motor controllers, as candidates for a guessed map.

    Parameters
    ----------
    tables
        Tables of one source. The first has the parameters of the autopilot.

    Yields
    ------
    Candidate
        The left and the right output, if the source has both: those with the functions of left and right throttle in
        the parameters SERVOn_FUNCTION. A side without such an output gets output 1 (left) or 3 (right), ArduPilot's
        default, if the log has no function of this output, and no output has the function of steering or of a single
        throttle. Then the shaft speed of each motor controller: n for one controller, n_left and n_right for two, else
        n_NUMBER.
    """
    nodes = {int(table.topic.rpartition("_")[2]): table for table in tables if table.kind == "Servo"}
    p = tables[0].parameters if tables else {}
    functions = _servo_functions(tables)
    node_of_function = {function: node for node, function in functions.items()}
    # The default outputs are used only if the log has no other function for them, and the boat has no steering output.
    is_default = not {STEERING, THROTTLE} & set(functions.values())
    left = node_of_function.get(LEFT_THROTTLE, 1 if is_default and 1 not in functions else None)
    right = node_of_function.get(RIGHT_THROTTLE, 3 if is_default and 3 not in functions else None)
    for node, name in ((left, "n_left"), (right, "n_right")) if {left, right} <= set(nodes) else ():
        assert node is not None
        known = "n" in nodes[node].columns  # a rig has scaled the output
        by_parameters = bool(functions) and f"SERVO{node}_TRIM" in p
        extra, caveat = _pulse_scale(p, node) if by_parameters else (OUTPUT, CAVEATS["RCOut"])
        extra = 'role = "input", hold = "sampled"' if known else extra
        taken = MapSignal(name, ("n" if known else "pwm",), "1", "", extra)
        yield Candidate("drive", 0, nodes[node], (taken,), "" if known else caveat)
    shafts = sorted((t for t in tables if t.kind == "Esc" and "rpm" in t.columns), key=_controller_sort_key)
    # All controllers get the same scale, so that equal speeds stay equal.
    top = max((float(np.nanmax(np.abs(t.columns["rpm"]), initial=0.0)) for t in shafts), default=0.0) or 1.0
    for k, table in enumerate(shafts):
        node = _controller_sort_key(table)[0]
        name = (("n",) if len(shafts) == 1 else ("n_left", "n_right"))[k] if len(shafts) <= 2 else f"n_{node}"
        caveat = f"controller {node} is assumed to be {name}; the speed of a VESC is electrical"
        taken = MapSignal(name, ("rpm",), "1", "", 'role = "input", hold = "linear"', top)
        yield Candidate("drive", 1, table, (taken,), caveat)


def _servo_functions(tables: Sequence[Table]) -> dict[int, float]:
    """Return the function of each servo output of an autopilot, the parameter SERVOn_FUNCTION, by its number n.

    Outputs are those with a table of kind "Servo". An output whose parameter is not in the log is left out. The result
    is in the order of the numbers. The first table has the parameters.
    """
    p = tables[0].parameters if tables else {}
    nodes = sorted(int(table.topic.rpartition("_")[2]) for table in tables if table.kind == "Servo")
    return {node: p[key] for node in nodes if (key := f"SERVO{node}_FUNCTION") in p}


def _controller_sort_key(table: Table) -> tuple[int, str]:
    """Return the sort key of a motor controller's table: the number at the end of its topic (esc_1), then the topic.

    With several buses, the topic begins with the bus.
    """
    return int(table.topic.rpartition("_")[2]), table.topic


def _pulse_scale(p: Mapping[str, float], node: int) -> tuple[str, str]:
    """Return the keys of an import map that scale the pulses of an autopilot's output to -1 .. 1, and the caveat.

    The keys are TOML text: scale, offset, role and hold, and that a pulse of 0 (no pulse) means the command 0.

    The parameters `p` of the autopilot give the scale: SERVOn_MIN, SERVOn_TRIM, SERVOn_MAX and SERVOn_REVERSED of the
    output `node`. A parameter that is missing has its default (1100, 1500, 1900 us, not reversed). SERVOn_REVERSED
    other than 0 changes the sign. If MIN is not below MAX, the default scale is used without any of the parameters,
    with a caveat. Another caveat is returned if TRIM is not in the middle. Otherwise the caveat is "".
    """
    low, rest, high = (p.get(f"SERVO{node}_{word}", usual) for word, usual in PULSE_US)
    if not low < high:
        return OUTPUT, f"SERVO{node}_MIN is not below SERVO{node}_MAX and is ignored; {CAVEATS['RCOut']}"
    scale = (-2.0 if p.get(f"SERVO{node}_REVERSED", 0.0) else 2.0) / (high - low)
    ends = abs(scale) * (high - rest), abs(scale) * (low - rest)
    caveat = f"SERVO{node}_TRIM is not in the middle: full commands are {ends[0]:.3g} and {ends[1]:.3g}, not 1 and -1; "
    caveat += "name a rig in [mavlink] of the map to scale each direction"
    extra = f'scale = {scale:.9g}, offset = {0.0 - scale * rest:.9g}, missing = 0, missing_is = 0, role = "input", '
    extra += 'hold = "sampled"'
    return extra, caveat if high - rest != rest - low else ""


# The choice


class _SignalLine(NamedTuple):
    """Line of a chosen signal in a guessed map.

    Attributes
    ----------
    text : str
        The signal as an inline table of TOML.
    remark : str
        Remark on its scale at the end of the line; "" without one.
    caveat : str
        Caveat in the line before; "" without one.
    """

    text: str
    remark: str
    caveat: str


class _SignalLines(NamedTuple):
    """Lines of the signals of a guessed map.

    Attributes
    ----------
    chosen : dict
        Lines of the chosen signals by the id of their table and by name.
    others : list
        Id of the table, and the line, of each candidate that was not chosen.
    """

    chosen: dict[int, dict[str, _SignalLine]]
    others: list[tuple[int, str]]

    def of(self, tables: Sequence[Table]) -> list[str]:
        """Return the lines of tables: each chosen signal behind its caveat, then the other candidates as comments."""
        ids = {id(table) for table in tables}
        chosen = {name: line for key in ids for name, line in self.chosen.get(key, {}).items()}
        places = {name: k for k, name in enumerate(NAMES)}
        lines, last_caveat = [], ""
        for name in sorted(chosen, key=lambda name: (places.get(name, len(places)), name)):
            line, remark, caveat = chosen[name]
            lines += [f"  # caveat: {caveat}"] * bool(caveat and caveat != last_caveat) + [f"  {line},{remark}"]
            last_caveat = caveat
        others = [line for key, line in self.others if key in ids]
        return lines + (["  # also in the source, each in place of the signal of its name:", *others] if others else [])


def _chosen_signals(
    candidates: Sequence[Candidate], clocks: Clocks, mains: Clocks, n_files: Mapping[str, int]
) -> tuple[list[MapSignal], _SignalLines]:
    """Choose the signals of a guessed import map. Return them, and the lines of the map.

    Candidates are tried in the order of their rank, then of the number of their rows, the largest first. For this
    order, 2 is added to the rank of a thruster of which only one side was found, so that it comes later. A candidate is
    chosen if its rank is below `UNCHOSEN_RANK` (5), none of its signals has been chosen before, it has times (or no
    table of its file has a column of times), and its thrusters have the same quantity as those of its group that were
    chosen before. A speed without direction is not chosen after u. Commands and shaft speeds are not chosen if the
    source has forces of a left or right thruster, or if the vehicle is no boat. `mains` has the time column in [time]
    of the map for each table, and `clocks` its own, by the id of the table. `n_files` is the number of files that
    share the guessed scale of a signal, by signal; by default it is one.
    """

    sides: dict[frozenset[str], set[str]] = {}
    for c in candidates:
        sides.setdefault(c.quantity, set()).update(signal.name for signal in c.signals)

    def order(c: Candidate) -> tuple[int, int]:
        """Return the sort key of a candidate: its rank, then its number of rows, the largest first.

        The rank is raised by 2 if the source has thrusters of this quantity on one side only.
        """
        single = c.quantity and any(len(sides[c.quantity].intersection(pair)) == 1 for pair in PAIRS)
        return c.rank + 2 * bool(single), -len(c.table)

    quantities: dict[str, frozenset[str]] = {}  # quantity of the chosen thrusters, by group
    taken: dict[str, MapSignal] = {}
    usable = [c for c in candidates if c.rank < UNCHOSEN_RANK]
    has_force = any(s.name in ("f_left", "f_right") for c in usable for s in c.signals)
    found = _SignalLines({}, [])
    for candidate in sorted(candidates, key=order):
        names = {signal.name for signal in candidate.signals}
        free = candidate.rank < UNCHOSEN_RANK and not names & set(taken) and not (names == {"speed"} and "u" in taken)
        free &= not (candidate.group in THRUSTERS and (has_force or candidate.table.vehicle not in (None, *BOATS)))
        free &= not candidate.quantity or quantities.get(candidate.group, candidate.quantity) == candidate.quantity
        clock, main = clocks[id(candidate.table)], mains[id(candidate.table)]
        free &= bool(
            candidate.table.t is not None or clock.column or not main.column
        )  # the table has times, or no table has times
        if free and candidate.quantity:
            quantities[candidate.group] = candidate.quantity
        for signal in candidate.signals:
            line = _signal_line(candidate.table, signal, clock, main)
            remark = _scale_remark(signal, n_files.get(signal.name, 1))
            if free:
                taken[signal.name] = signal
                shown = _SignalLine(
                    line, _scale_remark(signal, n_files.get(signal.name, 1)), _caveat_of(candidate, signal)
                )
                found.chosen.setdefault(id(candidate.table), {})[signal.name] = shown
            else:
                reason = "; ".join(part for part in (remark.strip("# "), candidate.caveat) if part)
                found.others.append((id(candidate.table), f"  # {line}," + (f"  # {reason}" if reason else "")))
    return list(taken.values()), found


def _caveat_of(candidate: Candidate, signal: MapSignal) -> str:
    """Return the caveat of a chosen signal: first that its full speed is a guess, then the caveat of its candidate."""
    top = ""
    if signal.at_command:
        top = f"{signal.full:.5g} is assumed to be full forward, as its greatest number follows the greatest command, "
        top += f"{signal.at_command:.3g}"
    elif signal.full and not signal.is_given:
        top = f"its greatest number, {signal.full:.5g}, is assumed to be full forward"
    return "; ".join(part for part in (top, candidate.caveat) if part)


def _signal_line(table: Table, signal: MapSignal, clock: Clock, main: Clock) -> str:
    """Return one signal of an import map as an inline table of TOML: name, topic, columns, unit and further keys.

    The line names the time column of the signal's own table (`clock`) if the column or its format differs from `main`,
    the time column in [time] of the map. A signal made of several columns has no unit in the line.
    """
    keys = [f"name = {_toml_text(signal.name)}"]
    if table.topic:
        keys.append(f"topic = {_toml_text(table.topic)}")
    word = "field" if table.topic else "column"
    if signal.make:
        keys += [f"make = {_toml_text(signal.make)}", f"{word}s = [{', '.join(_toml_text(c) for c in signal.columns)}]"]
    else:
        keys += [f"{word} = {_toml_text(signal.columns[0])}", f"unit = {_toml_text(signal.unit)}"]
    if clock.column and (clock.column, clock.form) != (main.column, main.form):
        keys.append(f"time = {_toml_text(clock.column)}")
        keys += [f"time_format = {_toml_text(clock.form)}"] * (clock.form != main.form)
    keys += [f"scale = {1.0 / signal.full:.9g}"] if signal.full else []
    return f"{{ {', '.join([*keys, *([signal.extra] if signal.extra else [])])} }}"


def _unrecognised_columns(
    tables: Sequence[Table], candidates: Sequence[Candidate], clocks: Clocks
) -> list[tuple[Table, str]]:
    """Return the columns that were not recognised, each with its table.

    Columns of text, of times, and without a finite value are left out. So are tables with a type of messages, except
    single numbers (Float64, Float32), messages of a DBC, and efforts of joints (JointState) that vary. The list is
    empty if all columns were recognised. `clocks` has the time column of each table, by the id of the table.
    """
    used = {(id(c.table), column) for c in candidates for signal in c.signals for column in signal.columns}
    found = []
    for table in tables:
        message = table.kind.rpartition("/")[2]
        if message not in ("", "Float64", "Float32", "dbc", "JointState"):
            continue
        for column in table.names:
            if not column or (id(table), column) in used or column == clocks[id(table)].column:
                continue
            if message == "JointState" and not (column.startswith(EFFORT) and _varies(table.numbers(column))):
                continue
            try:
                values = table.numbers(column)
            except SeatrialError:
                continue
            if np.isfinite(values).any():
                found.append((table, column))
    return found


def _unrecognised_lines(columns: Sequence[tuple[Table, str]]) -> list[str]:
    """Return comment lines of a guessed map for the columns that were not recognised, with the range of their values.

    At most 12 columns are listed, and a last line has the number of the others. The list is empty without columns.
    """
    lines = []
    for table, column in columns[:MOST_LISTED]:
        values = table.numbers(column)
        stated = f" [{table.units[column]}]" if column in table.units else ""
        unit = read_name(column + stated).unit or "1"
        line = _signal_line(table, MapSignal("NAME", (column,), unit), Clock(), Clock())
        lines.append(f"  # {line},  # {np.nanmin(values):.4g} .. {np.nanmax(values):.4g}")
    if not lines:
        return []
    more = [f"  # and {len(columns) - MOST_LISTED} more"] if len(columns) > MOST_LISTED else []
    return ["  # not recognised:", *lines, *more]


def _missing_for_fit(taken: Sequence[MapSignal], tables: Sequence[Table]) -> str:
    """Return the reason why no model can be fitted to the chosen signals; "" if a fit should be possible.

    Of several reasons the first is returned. The table of a thrust stand (force and command) needs no motion. The
    thrusters are n, X or N, or a left and a right one. The length of the recording is known only for tables with their
    own times. Reasons are another vehicle than a boat, no motion, no thrusters, one side alone, or a recording shorter
    than 1 s.
    """
    if any(table.vehicle not in (None, *BOATS) for table in tables):
        vehicle = next(table.vehicle for table in tables if table.vehicle not in (None, *BOATS))
        text = f"the vehicle of this log is not a boat (MAV_TYPE {vehicle}), so its outputs are not thrusters of a boat"
        return f"{text}; if they are, name them by hand in the import map"
    names = {signal.name for signal in taken}
    if {"force", COMMAND} <= names:  # a thruster on the bench
        return ""
    if not names & set(MOTION):
        return "no position, velocity, heading or yaw rate was recognised; name one by hand in the import map"
    if not (any(names.issuperset(pair) for pair in PAIRS) or names & {"n", "X", "N"}):
        functions = _servo_functions(tables)
        if functions and not {LEFT_THROTTLE, RIGHT_THROTTLE} <= set(functions.values()):
            listed = (
                f"SERVO{n}_FUNCTION {f:g}{f' ({FUNCTIONS[f]})' if f in FUNCTIONS else ''}" for n, f in functions.items()
            )
            text = f"its outputs are not a left and a right throttle: {', '.join(listed)}"
            return f"{text}; name the inputs by hand in the import map"
        if half := names & {name for pair in PAIRS for name in pair}:
            return f"only {', '.join(sorted(half))} of the thrusters was recognised; name the other side by hand"
        text = "no commands, shaft speeds or forces of thrusters were recognised, and a model needs an input"
        return f"{text}; name them by hand in the import map"
    spans = [t.t[-1] - t.t[0] for t in tables if t.t is not None and len(t.t) > 1]
    if spans and max(spans) < 1.0:
        return f"the recording is only {max(spans):.2g} s long; record a longer run"
    return ""
