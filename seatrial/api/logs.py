"""Logs of the Python interface: their signals, their checks, and the import of logs of other software."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from seatrial.api.arguments import as_path, check_number, named_arguments
from seatrial.api.figures import Figure
from seatrial.api.messages import OF_IMPORT, OF_WINDOW, errors_of_users, in_python
from seatrial.api.series import Series
from seatrial.api.shown import Content, Shown, number
from seatrial.daq.checks import FAULT, WARNING, Finding, findings_lines, findings_summary, worst_first
from seatrial.daq.errors import SeatrialError, UnknownName, closest_name, counted, file_hint, first_names, warn
from seatrial.daq.log import import_library, log_file, require_logs

if TYPE_CHECKING:
    from seatrial.daq.importers.boat_tables import BoatTable
    from seatrial.daq.importers.guess import Guess
    from seatrial.ident.data import LoadedLog, TimeWindow

PathLike = str | Path
SHOWN = 16  # signals in the short description of a log
# Signals by other names, beside those that an import recognises
ALIASES = {"roll": "phi", "pitch": "theta", "speed": "u"}


@dataclass(frozen=True, repr=False)
class Signal:
    """One signal of a log with its own sample times.

    Attributes
    ----------
    name : str
        Name, for example ``psi``.
    unit : str
        Unit (SI, radians). Empty for a number without a unit, or if the unit is unknown.
    t : Array (n,)
        Sample times [s], from the first sample of the log.
    value : Array (n,)
        Samples.
    """

    name: str
    unit: str
    t: NDArray[np.float64]
    value: NDArray[np.float64]

    def __repr__(self) -> str:
        """Return a short text for the interpreter: name, unit, number of samples and median rate [Hz]."""
        rate = f", {1.0 / float(np.median(np.diff(self.t))):.3g} Hz" if self.t.size > 1 else ""
        return f"<Signal {self.name} [{self.unit or '1'}]: {self.t.size} samples{rate}>"

    def to_pandas(self) -> Any:
        """Return the signal as a ``pandas.Series``, whose index is the time [s].

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        return Series(self.t, self.value).to_pandas().rename(self.name)


@dataclass(frozen=True, repr=False)
class Log(Shown, Mapping[str, Signal]):
    """Log, or a window of it, with the signals that models use. It is a mapping of its signals by name.

    Attributes
    ----------
    path : Path
        File or folder of the log.
    start, end : float
        Window that was opened [s], from the first sample of the log; ``end`` is infinite for a log that is used to its
        end.
    signals : dict of str to Signal
        Signals by name, in SI units and radians.
    """

    path: Path
    start: float
    end: float
    signals: Mapping[str, Signal]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample of all signals [s]."""
        first = min(s.t[0] for s in self.signals.values())
        return float(max(s.t[-1] for s in self.signals.values()) - first)

    def __getitem__(self, name: str) -> Signal:
        """Return the signal of this name. `UnknownName` names the similar signal, or all signals, if there is none."""
        if name not in self.signals:
            from seatrial.daq.importers.recognise import read_name  # imported here, as only this error needs it

            text = str(name)  # a number is no name, but may be given by mistake
            near = closest_name(ALIASES.get(text) or read_name(text).meaning or text, self.signals)
            hint = f"did you mean {near!r}? It" if near else "it"
            raise UnknownName(f"{self.path.name} has no signal {name!r}; {hint} has {', '.join(self.signals)}")
        return self.signals[name]

    def __iter__(self) -> Iterator[str]:
        """Return an iterator over the names of the signals."""
        return iter(self.signals)

    def __len__(self) -> int:
        """Return the number of signals."""
        return len(self.signals)

    def __contains__(self, name: object) -> bool:
        """Return whether the log has a signal of this name."""
        return name in self.signals

    def _content(self) -> Content:
        """Return name and duration of the log, and a table of its signals."""
        rows = [
            (s.name, s.unit, str(s.t.size), number(1.0 / float(np.median(np.diff(s.t))), 3) if s.t.size > 1 else "")
            for s in self.signals.values()
        ]
        answer = f"{self.path.name}: {self.duration:.1f} s, {counted(len(rows), 'signal')}"
        return Content(answer, (), ("signal", "unit", "samples", "rate [Hz]"), rows)

    def __repr__(self) -> str:
        """Return a short text for the interpreter: file name, duration and the names of the first 16 signals."""
        names = list(self.signals)
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return f"<Log {self.path.name}: {self.duration:.1f} s, {len(names)} signals: {', '.join(names[:SHOWN])}{more}>"

    def to_pandas(self) -> Any:
        """Return all signals as a ``pandas.DataFrame`` with a column for each signal; the index is the time [s].

        Each row is a sample time of at least one signal. A signal without a sample at that time is NaN.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        return import_library("pandas").concat([s.to_pandas() for s in self.signals.values()], axis=1).sort_index()

    def plot(self, *names: str) -> Figure:
        """Return a figure of the signals with these names, or of all signals.

        Parameters
        ----------
        *names : str
            Names of signals; without names all signals are drawn.

        Raises
        ------
        KeyError
            If the log has no signal of a name.
        """
        from seatrial.ident.report import Panel, dots, stacked

        chosen = [self[n] for n in names] or list(self.signals.values())
        panels = [Panel(f"{s.name} [{s.unit or '1'}]", [dots(s.t, s.value, s.name, 3000)]) for s in chosen]
        figure, height = stacked(panels, "time [s]")
        return Figure(self.path.name, figure["data"], figure["layout"] | {"height": height, "showlegend": False})


@named_arguments
def open_log(path: PathLike, start: float = 0.0, end: float = np.inf) -> Log:
    """Open a log and read its signals.

    Parameters
    ----------
    path : str or Path
        Log: a .mcap file, the first of its segments, or a folder with this log alone.
    start, end : float
        Window of time to read, ``start <= t < end`` [s], from the first sample of the log. By default the whole log.

    Returns
    -------
    Log
        The signals that models use, without outliers. A signal without a sample in the window is left out.
        `seatrial.daq.log.open_log` reads the recorded messages instead.

    Raises
    ------
    SeatrialError
        If the file is not a log, has no signal for an identification, ends before ``start``, or has no sample in the
        window; if ``end`` is not after ``start``.

    Examples
    --------
    >>> log = st.open_log("run1.mcap", start=20.0)
    >>> log["psi"].value
    """
    from seatrial.ident.data import TimeWindow, load_run

    if len(files := as_paths(path)) > 1:
        raise SeatrialError(f"{len(files)} logs: st.open_log opens one log; give the path of one, or call it for each")
    (file,) = files
    check_number("start", start, "s")
    check_number("end", end, "s")
    window = TimeWindow(float(start), float(end))  # a number of numpy would not fit into a result
    with errors_of_users(OF_WINDOW):
        window.check()
        return _log_of(load_run(file, "estimation", window), file, window)


def _log_of(loaded: LoadedLog, path: Path, window: TimeWindow) -> Log:
    """Return a `Log` from a loaded log: its signals, cut to the window ``t_from <= t < t_to`` [s].

    A signal without a sample in the window is left out. `path` is the file or folder of the log.
    """
    signals = {}
    for name, channel in loaded.run.channels.items():
        inside = (channel.t >= window.t_from) & (channel.t < window.t_to)
        if inside.any():
            signals[name] = Signal(name, channel.unit, channel.t[inside], channel.value[inside])
    return Log(path, window.t_from, window.t_to, signals)


@named_arguments
def guess_map(
    files: PathLike | Sequence[PathLike],
    path: PathLike | None = None,
    force: bool = False,
    *,
    geometry: BoatTable | None = None,
    scale: BoatTable | None = None,
    full_speed: Mapping[str, float] | None = None,
) -> str:
    """Guess the import map of files of other software, as ``seatrial import --guess``.

    Correct its text where it has caveats, and give it to `import_log` as ``map_path``.

    Parameters
    ----------
    files : path or sequence of paths
        Files, folders of ROS bags, or folders with the files of a run. The columns are those of the first run; a scale
        that is guessed from numbers is that of all. Files of different columns at the same time are one run, and the
        map has a [[file]] for each.
    path : path, optional
        File to which the map is written. None: it is only returned.
    force : bool
        Whether an existing file is replaced. If false, an existing file with another text is an error.
    geometry : dict, optional
        Numbers of the boat for the table [geometry]: ``y_left``, ``y_right`` (thrusters to starboard of the middle
        [m]), ``x_thrusters`` (thrusters forward of the centre of gravity [m], negative behind it), ``mass`` (weighed
        [kg]), ``length`` (hull [m]), ``lever_arm_m`` (antenna forward, to starboard and down [m]),
        ``lever_arm_sd`` (its standard uncertainty [m]).
    scale : dict, optional
        Thrust of one thruster at full speed [N] for the table [scale]: ``ahead`` and ``astern``, with their standard
        uncertainties ``ahead_sd`` and ``astern_sd``. In place of these, ``c1`` (mean of ahead and astern) and ``c2``
        (half of ahead less astern), with ``c1_sd`` and ``c2_sd``.
    full_speed : dict, optional
        Number of the source at full speed ahead, by signal, in place of a guess from the largest number, for example
        ``{"n_left": 2900, "n_right": 2900}`` for shaft speeds in rpm.

    Returns
    -------
    str
        Text of the map (TOML), with comments on what is uncertain.

    Raises
    ------
    SeatrialError
        If a file does not exist or cannot be read, if a number or a name of the boat is wrong, or if the map cannot be
        written.

    Examples
    --------
    >>> boat = dict(geometry={"y_left": -0.3, "y_right": 0.3, "mass": 32.0}, scale={"ahead": 45.0, "astern": 35.0})
    >>> print(st.guess_map(["lake_1.csv", "lake_2.csv"], "lake.toml", **boat))
    >>> logs = st.import_log(["lake_1.csv", "lake_2.csv"], map_path="lake.toml")
    """
    from seatrial.daq.files import write_output
    from seatrial.daq.importers.boat_tables import with_boat_tables
    from seatrial.daq.importers.guess import guess_maps
    from seatrial.daq.importers.import_map import parse_import_map
    from seatrial.daq.importers.write_log import replacing

    sources, out = as_paths(files, folders=False), None if path is None else as_path(path, "path")
    _check_full_speed(full_speed)
    with errors_of_users({"-o": "path"}):
        guess = guess_maps(sources, folder=None if out is None else out.parent, known=full_speed)[0]
        of_map = out or Path(f"guessed map of {sources[0].name}")
        text = with_boat_tables(guess.text, of_map, geometry, scale)
        if geometry or scale:
            _require_signals(sources[0], guess)
            parse_import_map(text, of_map)  # an error of the numbers is one of this call
        # A notebook cell that runs again finds its own map.
        if out is not None and not (out.is_file() and out.read_bytes() == text.encode()):
            with replacing(out, force, [*sources, *guess.run.paths]) as part:
                write_output(part, text)
    for line in guess.assumed:
        warn(line)
    return text


def import_log(
    files: PathLike | Sequence[PathLike],
    map_path: PathLike | None = None,
    out_dir: PathLike = ".",
    force: bool = False,
    *,
    geometry: BoatTable | None = None,
    scale: BoatTable | None = None,
    full_speed: Mapping[str, float] | None = None,
) -> list[Path]:
    """Convert files of other software to logs, as ``seatrial import``.

    Parameters
    ----------
    files : path or sequence of paths
        Files: text tables, bags of ROS, DataFlash, ULog, MATLAB and others; or folders, each with the files of one run.
    map_path : path, optional
        Import map, which assigns columns to signals. None: a map is guessed for each run; a scale that is guessed from
        numbers is the same for all runs. A `SeatrialWarning` says what was inferred from the data. Look at the map
        before you rely on it (`guess_map`).
    out_dir : path
        Folder of the logs, which is created. A log has the name of its file or folder; if the map merges files that
        were given without a folder, that of the map.
    force : bool
        Whether existing logs are replaced. If false, an existing log is an error.
    geometry, scale : dict, optional
        Numbers of the boat, as of `guess_map`. They replace those of the map.
    full_speed : dict, optional
        Numbers at full speed, as of `guess_map`, for a guessed map only.

    Returns
    -------
    list of Path
        Paths of the written logs.

    Raises
    ------
    SeatrialError
        If a file does not exist or cannot be read, if no signal can be recognised, if a number or a name of the boat is
        wrong, or if a log exists already.

    Examples
    --------
    >>> (log,) = st.import_log("run.csv", out_dir="logs", scale={"ahead": 45.0, "astern": 35.0})
    """
    from tempfile import TemporaryDirectory

    from seatrial.daq.importers.guess import guess_maps
    from seatrial.daq.importers.import_files import import_files

    sources, folder = as_paths(files, folders=False), as_path(out_dir, "out_dir")
    import_map = None if map_path is None else as_path(map_path, "map_path")
    _check_full_speed(full_speed)
    if import_map is not None and full_speed:
        raise SeatrialError("full_speed is for a guessed map; give scale = 1 / (number at full speed) in map_path")
    made: list[Path] = []
    with errors_of_users(OF_IMPORT):
        if import_map is not None:
            return import_files(import_map, sources, out_dir=folder, force=force, geometry=geometry, scale=scale)
        guesses = guess_maps(sources, known=full_speed)
        for guess in guesses:
            _require_signals(guess.run.source, guess)
    for line in guesses[0].assumed:
        warn(line)
    _warn_of_guesses(guesses, _given_words(geometry, scale, full_speed))
    with errors_of_users(OF_IMPORT), TemporaryDirectory() as scratch:
        for guess in guesses:
            source = guess.run.source
            guessed = Path(scratch) / f"{guess.run.name}.toml"
            guessed.write_text(guess.text, encoding="utf-8")
            is_alone = sum(other.run.source == source for other in guesses) == 1
            read = [source] if source.is_dir() and is_alone else guess.run.paths
            try:
                made += import_files(guessed, read, out_dir=folder, force=force, geometry=geometry, scale=scale)
            except SeatrialError as problem:
                if type(problem) is not SeatrialError or str(guessed) not in str(problem):
                    raise
                text = str(problem).replace(str(guessed), f"guessed map of {source}")
                raise SeatrialError(text).with_traceback(problem.__traceback__) from problem.__cause__
    return made


def _check_full_speed(numbers: Mapping[str, float] | None) -> None:
    """Raise SeatrialError if the numbers at full speed ahead are no mapping by signal, or one is not positive."""
    if numbers is not None and not isinstance(numbers, Mapping):
        raise SeatrialError(
            f"full_speed, {numbers!r}: give the number of each signal, such as full_speed={{'n_left': 2600, 'n_right': "
            "2600}, in the unit of the source"
        )
    for name, number_at_full in (numbers or {}).items():
        if isinstance(number_at_full, bool) or not isinstance(number_at_full, Real) or not 0.0 < number_at_full < inf:
            raise SeatrialError(
                f"full_speed of {name}, {number_at_full!r}: give the number at full speed ahead, above zero"
            )


def _require_signals(source: Path, guess: Guess) -> None:
    """Raise SeatrialError if no signal was recognised in a source file, so that its guessed map is without signals."""
    content = tomllib.loads(guess.text)
    if content.get("file") or content.get("signal"):
        return
    columns = f" in {first_names(guess.unrecognised, 10)}" if guess.unrecognised else ""
    raise SeatrialError(
        f"{source}: no signal was recognised{columns}; write a map with {_guess_call([source])}, add the signals to "
        "it, and give it as map_path"
    )


def _given_words(geometry: BoatTable | None, scale: BoatTable | None, full_speed: Mapping[str, float] | None) -> str:
    """Return the end of the warning of guessed maps: the numbers that the user gave. It is empty if there are none."""
    tables = {"geometry": geometry, "scale": scale, "full_speed": full_speed}
    given = [f"{table} ({', '.join(numbers)})" for table, numbers in tables.items() if numbers]
    return f"; as given: {', '.join(given)}" if given else ""


def _warn_of_guesses(guesses: Sequence[Guess], given: str) -> None:
    """Warn of what guessed maps infer from the data, and of columns that were not recognised: once for files alike.

    ``given`` is the text about the numbers that the user gave, which are no guess. Files are alike if their caveats, or
    their columns, differ in numbers and in the name of the file at most. The text is then that of the first of them.
    """
    guessed, left_out = dict[Any, list[tuple[list[Path], str]]](), dict[Any, list[tuple[list[Path], str]]]()
    for guess in guesses:
        source = guess.run.source
        is_alone = sum(other.run.source == source for other in guesses) == 1  # not one of several runs in a folder
        sources = [source] if source.is_dir() and is_alone else list(guess.run.paths)
        found = re.findall(r"# caveat: (.+)", guess.text)
        found += [f"not measured: {text}" for text in re.findall(r"# not measured: (.+)", guess.text)]
        caveats = "; ".join(dict.fromkeys(found))
        columns = first_names(guess.unrecognised, 10) if guess.unrecognised else ""
        for text, groups in ((caveats, guessed), (columns, left_out)):
            if text:
                groups.setdefault(re.sub(r"\d+", "", text.replace(source.stem, "")), []).append((sources, text))
    for alike in guessed.values():
        paths, names = _of_group(alike)
        one = len({text for _, text in alike}) == 1
        of_first = "" if one else f", in {paths[0].name}"
        warn(
            f"{names}: without an import map, this was inferred from the data{of_first}: {alike[0][1]}{given}; if it "
            f"is wrong, correct the map of {_guess_call(paths)} and give it as map_path"
        )
    for alike in left_out.values():
        paths, names = _of_group(alike)
        warn(
            f"{names}: not recognised and left out: {alike[0][1]}; add those that a fit needs to the map of "
            f"{_guess_call(paths)} and give it as map_path"
        )


def _of_group(alike: Sequence[tuple[Sequence[Path], str]]) -> tuple[list[Path], str]:
    """Return the paths of runs that are alike, and their names for a message."""
    paths = [source for sources, _ in alike for source in sources]
    return paths, first_names([source.name for source in paths], 5)


def _guess_call(paths: Sequence[Path]) -> str:
    """Return the call that writes the guessed map of files to map.toml; it runs in any folder."""
    absolute = [str(path.absolute()) for path in paths]
    files: object = absolute[0] if len(absolute) == 1 else absolute
    return f"st.guess_map({files!r}, 'map.toml')"


class Findings(Shown, tuple[Finding, ...]):
    """Findings of a check as a tuple, the worst first. `check` returns it.

    Each finding has ``level`` (ok, unknown, warning or fault), ``code``, ``check``, ``where``, ``text`` and ``advice``.

    Attributes
    ----------
    logs : tuple of str
        Names of the checked logs; empty for findings that were joined or cut.
    """

    logs: tuple[str, ...] = ()

    @property
    def faults(self) -> list[Finding]:
        """Findings of the level fault. A fault makes a fit or a run meaningless. The list may be empty."""
        return [f for f in self if f.level == FAULT]

    @property
    def warnings(self) -> list[Finding]:
        """Findings of the level warning. A warning needs attention. The list may be empty."""
        return [f for f in self if f.level == WARNING]

    def _content(self) -> Content:
        """Return the numbers of faults and warnings, and a table of the findings."""
        rows = [(f.level, f.check, f.where, f.text, f.advice) for f in self]
        return Content(self._summary(), (), ("level", "check", "where", "finding", "advice"), rows)

    def __repr__(self) -> str:
        """Return one line for each finding, and a line with the logs and the numbers of faults and warnings."""
        return "\n".join([*findings_lines(self), self._summary()])

    def _summary(self) -> str:
        """Return the numbers of faults and warnings, after the name of the log, or the number of several logs."""
        of = self.logs[0] if len(self.logs) == 1 else f"{len(self.logs)} logs"
        return f"{of}: {findings_summary(self)}" if self.logs else findings_summary(self)

    def to_pandas(self) -> Any:
        """Return the findings as a ``pandas.DataFrame`` with a row for each finding.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        return import_library("pandas").DataFrame(list(self), columns=list(Finding._fields))


@named_arguments
def check(logs: PathLike | Log | Sequence[PathLike | Log]) -> Findings:
    """Check logs, as ``seatrial check``: devices, sensors, thrusters and the motion between them.

    Parameters
    ----------
    logs : path, `Log` or sequence of them
        Files or folders of the logs. Of a `Log`, its own window is checked.

    Returns
    -------
    Findings
        The findings, the worst first. With several logs, ``where`` begins with the name of the log.
        Times in the findings count from the start of the whole log.

    Raises
    ------
    SeatrialError
        If no log is given, or if a file does not exist or is not a log.

    Examples
    --------
    >>> st.check("run1.mcap").faults
    []
    """
    from seatrial.bench.preflight.log_findings import log_findings
    from seatrial.daq.log import WHOLE, TimeWindow
    from seatrial.ident.checks import LogChecks

    checks, (paths,) = LogChecks(), as_logs(logs)
    windows = [TimeWindow(x.start, x.end) if isinstance(x, Log) else WHOLE for x in as_list(logs)]
    with errors_of_users():
        found = worst_first(log_findings(checks.check, paths, checks.differences, windows))
    findings = Findings(f._replace(text=in_python(f.text), advice=in_python(f.advice)) for f in found)
    findings.logs = tuple(path.name for path in paths)
    return findings


def as_list(logs: PathLike | Log | Sequence[PathLike | Log]) -> list[PathLike | Log]:
    """Return one log or several logs as a list, in their order. One object of another class is a list of one, too.

    A table, such as a ``pandas.DataFrame``, is one object: its items are names of columns, not logs.
    """
    if isinstance(logs, Iterable) and not isinstance(logs, str | Mapping) and not hasattr(logs, "columns"):
        return list(logs)
    return [logs]  # type: ignore[list-item]  # an object of another class, which the caller refuses


def as_logs(*groups: PathLike | Log | Sequence[PathLike | Log]) -> list[list[Path]]:
    """Return the paths of each group of logs, as `as_paths`, once the files of all groups are known to be logs.

    Raises
    ------
    SeatrialError
        As `as_paths`, or if files are no logs. The error then names all such files of all groups.
    """
    paths = [as_paths(group) for group in groups]
    with errors_of_users():
        require_logs(path for group in paths for path in group)
    return paths


def as_paths(
    logs: PathLike | Log | Sequence[PathLike | Log], existing: bool = True, folders: bool = True
) -> list[Path]:
    """Return the paths of one log or of several logs, given as paths or as `Log`. The window of a `Log` is not used.

    The order is kept, and a log that is given twice is returned twice. With ``existing``, a path must exist. With
    ``folders`` too, a folder stands for the only log in it. The content of a file is not read.

    Raises
    ------
    SeatrialError
        If a log does not exist, if a folder is not that of one log, if a model or a pattern is given, or if nothing is
        given.
    """
    paths = []
    for log in as_list(logs):
        if not isinstance(log, Log | str | Path):
            advice = ""
            if hasattr(log, "params"):
                advice = "; the model comes first, then the logs"
            elif isinstance(log, Mapping) or hasattr(log, "columns") or hasattr(log, "shape"):
                advice = "; write a table to a file first, such as run.csv, and import it with st.import_log"
            raise SeatrialError(
                f"{type(log).__name__}: this is not a log; give the path of a log or the result of st.open_log{advice}"
            )
        paths.append(log.path if isinstance(log, Log) else Path(log))
    if not paths:
        raise SeatrialError("no log was given; give at least one path")
    for path in paths:
        if any(sign in path.name for sign in "*?") and not path.exists():
            raise SeatrialError(
                f"{path}: a pattern is not expanded; give the folder, or "
                f"sorted(Path('{path.parent}').glob('{path.name}'))"
            )
    if not existing:
        return paths
    for path in paths:
        if not path.exists():
            raise SeatrialError(f"{path}: no such file or folder; {file_hint(path)}give the path of a log")
    with errors_of_users():
        return [log_file(path) for path in paths] if folders else paths
