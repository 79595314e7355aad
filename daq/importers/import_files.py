"""The command `seatrial import MAP.toml SOURCE...`: the import of source files by a map into logs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.daq.checks import (
    supply_line,
    supply_signals,
    too_many_rows_missing,
    unknown_names,
    unknown_names_text,
    unknown_times,
)
from seatrial.daq.errors import SeatrialError, counted, first_names, warn
from seatrial.daq.importers.boat_tables import BoatTable
from seatrial.daq.importers.import_map import TIME_UNITS, ImportMap, Piece, Source, load_import_map
from seatrial.daq.importers.missing_inputs import gap_lines
from seatrial.daq.importers.run_files import (
    MOST_NAMED,
    files_of_folder,
    is_run_folder,
    name_of_folder,
    require_sources,
    tables_of_folder,
)
from seatrial.daq.importers.signals import TURNED, Held, RowsLeftOut, SignalData, Signals, coarse_advice, read_signals
from seatrial.daq.importers.sources import source_kind
from seatrial.daq.importers.table import Table
from seatrial.daq.importers.write_log import sha256_of, write_signals
from seatrial.daq.samples import Event

_WHOLE = Piece("", -1e18, 1e18)  # the piece of a map without [[log]]
ROUNDING_S = 1e-9  # of a time less the shift of its signal
LONGEST_RELATIVE_S = 1e7  # 116 days; times that are larger do not count from the start of a log


def import_files(
    map_path: Path,
    files: Sequence[Path],
    *,
    out: Path | None = None,
    out_dir: Path | None = None,
    force: bool = False,
    geometry: BoatTable | None = None,
    scale: BoatTable | None = None,
) -> list[Path]:
    """Import source files by an import map, which assigns their columns to signals, and write the logs.

    Remarks about the files, for example about rows left out, become warnings.

    Parameters
    ----------
    map_path
        The map.
    files
        The source files, and folders with the files of a run.
    out
        Path of the log; only if the import makes a single log.
    out_dir
        Folder of the logs; by default the current folder. The logs are named after the files, or after their folder or
        the map if it merges the files, and after the pieces of the map.
    force
        Whether existing logs are replaced.
    geometry, scale
        Numbers of the boat that replace those of the tables [geometry] and [scale] of the map.

    Returns
    -------
    list of Path
        The logs, in the order of the files and of the [[log]] tables of the map.

    Raises
    ------
    SeatrialError
        If a file cannot be read by the map, a log cannot be written, two logs would have the same path, or `out` is
        given for several logs; logs written before stay. Also, after all logs are written, if too many rows of a source
        are out of order or have wrong stamps: 5 or more, and more than 5 %.
    """
    import_map = load_import_map(map_path, geometry, scale)
    if unknown := unknown_names_text(s.name for source in import_map.sources for s in source.signals):
        warn(f"{map_path}: {unknown}")
    if assumed := assumed_roles_line(import_map):
        warn(f"{map_path}: {assumed}")
    signals = [signal for source in import_map.sources for signal in source.signals]
    of_supply = supply_signals(signal.name for signal in signals)
    # A role in the map shows that its author knows of the signal, as a guessed map does.
    if any(signal.is_role_assumed and signal.name in of_supply for signal in signals):
        warn(f"{map_path}: {supply_line(signal.name for signal in signals)}")
    groups = _files_of_logs(import_map, files)
    pieces_of = [_pieces_of_run(import_map, stem, group) for stem, group in groups]
    if out is not None and (n_logs := sum(map(len, pieces_of))) > 1:
        raise SeatrialError(f"{out}: -o names one log, but this import makes {n_logs}; use --out-dir")
    for piece in import_map.pieces:
        if not any(piece in pieces for pieces in pieces_of):
            warn(f"{map_path}: [[log]] match = '{piece.match}' matches none of the given files or folders; correct it")
    written: list[Path] = []
    runs_of: dict[Piece, list[str]] = {}  # names of the runs that each piece without match was cut from
    spoiled: list[tuple[Path, RowsLeftOut]] = []
    for (stem, group), pieces in zip(groups, pieces_of, strict=True):
        data = [_read_source(path, source) for path, source in group]
        if len(groups) > 1:
            pieces = _pieces_with_samples(data, pieces)
            if pieces == (_WHOLE,) and import_map.pieces and any(not piece.match for piece in import_map.pieces):
                warn(f"{group[0][0]}: no [[log]] has its times, so it becomes one log as a whole")
            for piece in pieces:
                runs_of.setdefault(piece, []).append(stem)
        shift = _shift_of_negative_times(data, [source for _, source in group], pieces)
        if shift:
            if _times_begin_below_zero(data, pieces):
                warn(f"{group[0][0]}: {_shift_line(shift)}")
            data = [source_file._replace(origin=shift) for source_file in data]
        for piece in pieces:
            name = f"{stem}_{piece.name}" if piece.name else stem
            target = out or (out_dir or Path()) / f"{name}.mcap"
            if target in written:
                raise SeatrialError(f"{target}: two of the files or [[log]] would become this log; rename one")
            reads = [
                map_path,
                *(path for _, sources in groups for path, _ in sources),
                *_files_named_in_map(import_map),
            ]
            _write_piece(import_map, stem, data, piece, target, force, reads, shift)
            written.append(target)
        for remark in (remark for source_file in data for remark in source_file.remarks):
            warn(remark)
        spoiled += [
            (source_file.path, row) for source_file in data for row in source_file.signals.left_out if _is_too_many(row)
        ]
    _warn_of_shared_pieces(map_path, runs_of)
    if spoiled:
        advice = "sort the rows by time; if a clock was set, import the data before and after it separately"
        if spoiled[0][1].why == "repeats":
            advice = f"its stamps are too coarse: {coarse_advice(spoiled[0][1].rate)}"
        elif spoiled[0][1].why == "pairs":
            advice = "two receivers or sensors write into one table: import each from its own file or topic"
        elif spoiled[0][1].why == "stamps":
            advice = "repair the clock of the driver, or cut the log where it failed: [[log]] t_from, t_to of the map"
        rest = f" ({counted(len(spoiled) - 1, 'more source')})" if len(spoiled) > 1 else ""
        raise SeatrialError(
            f"{spoiled[0][0]}: {spoiled[0][1].text}{rest}: the log is written, but too many rows are missing; {advice}"
        )
    return written


def assumed_roles_line(import_map: ImportMap) -> str:
    """Return a line on the signals that are outputs only because the map has no role for them; empty without any.

    Signals whose name a built-in model or the conversion of frames uses, and those that should have another name
    (`unknown_names`), are left out.
    """
    signals = [signal for source in import_map.sources for signal in source.signals]
    unclear = {name for name, advice in unknown_names(signal.name for signal in signals).items() if not advice} - TURNED
    names = dict.fromkeys(signal.name for signal in signals if signal.is_role_assumed and signal.name in unclear)
    if not names:
        return ""
    are = "no model uses this name, so it is" if len(names) == 1 else "no model uses these names, so they are"
    return (
        f"{', '.join(names)}: {are} imported as {'an output' if len(names) == 1 else 'outputs'} (measured "
        'values); give role = "input" for a command or another input, or role = "output" to confirm'
    )


def _pieces_of_run(import_map: ImportMap, stem: str, group: Sequence[tuple[Path, Source]]) -> tuple[Piece, ...]:
    """Return the pieces that may be cut from a run: the whole if no [[log]] table is for it.

    A table is for the run if it has no `match`, or if `match` fits the name of the log (`stem`) or of a file.
    """
    names = [stem, *(path.name for path, _ in group)]
    found = (piece for piece in import_map.pieces if any(fnmatch(name, piece.match or "*") for name in names))
    return tuple(found) or (_WHOLE,)


def _pieces_with_samples(data: Sequence[_SourceFile], pieces: Sequence[Piece]) -> tuple[Piece, ...]:
    """Return the pieces of one of several runs: without a [[log]] that names no run and has no time of this one.

    The result is the whole if no piece is left.
    """
    times = [signal.t for source_file in data for signal in source_file.signals.signals]
    found = (
        piece
        for piece in pieces
        if piece.match or any(bool(np.any((t >= piece.t_from) & (t <= piece.t_to))) for t in times)
    )
    return tuple(found) or (_WHOLE,)


def _warn_of_shared_pieces(map_path: Path, runs_of: Mapping[Piece, Sequence[str]]) -> None:
    """Warn of [[log]] tables without `match` that were cut from several runs. `runs_of` has the runs of each piece."""
    shared = {piece.name: runs for piece, runs in runs_of.items() if piece.name and not piece.match and len(runs) > 1}
    if shared:
        runs = next(iter(shared.values()))
        warn(
            f"{map_path}: [[log]] {first_names(list(shared), MOST_NAMED)}: cut from {len(runs)} runs "
            f"({first_names(list(runs), MOST_NAMED)}), whose times it fits; for one run, name it in the [[log]], as "
            f'match = "{runs[0]}"; for all of them, match = "*"'
        )


def _shift_of_negative_times(data: Sequence[_SourceFile], sources: Sequence[Source], pieces: Sequence[Piece]) -> float:
    """Return the time [s] that is added to all times of one log, so that its first sample is at zero; usually 0.

    Times that count from an event in the log, as the trigger of a recorder, can begin below zero. They are shifted if
    all times of the log are such: numbers of a time unit without `origin`, at most 116 days from zero. The files and
    pieces of one log have one clock, and so one shift. Times that the pieces leave out do not count.
    """
    formats = [
        fmt
        for source in sources
        for fmt in (source.time.format if source.time else "", *(s.time_format for s in source.signals if s.time))
    ]
    is_relative = all(fmt in TIME_UNITS for fmt in formats if fmt) and all(s.time for s in sources)
    times = [
        cut.t
        for source_file in data
        for signal in source_file.signals.signals
        for cut in (_within_piece(signal, piece) for piece in pieces)
        if len(cut.t)
    ]
    if not times or not is_relative or any(source_file.origin for source_file in data):
        return 0.0
    first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    return -first if -LONGEST_RELATIVE_S < first < 0.0 and last < LONGEST_RELATIVE_S else 0.0


def _times_begin_below_zero(data: Sequence[_SourceFile], pieces: Sequence[Piece]) -> bool:
    """Return whether a time of the files is below zero without the `time_shift` of its signal, which the map asks for.

    Times that the pieces leave out do not count.
    """
    return any(
        len(t := cut.t) and float(t[0]) - cut.signal.time_shift < -ROUNDING_S
        for source_file in data
        for signal in source_file.signals.signals
        for cut in (_within_piece(signal, piece) for piece in pieces)
    )


def _shift_line(shift: float) -> str:
    """Return the line for the user on a shift [s] of all times of a log (`_shift_of_negative_times`)."""
    return (
        f"its times begin at {-shift:.6g} s, before zero, and a log cannot: {shift:.6g} s are added to all times of "
        "this import, so that the log begins at zero; origin of [time] gives it a date instead"
    )


def _is_too_many(row: RowsLeftOut) -> bool:
    """Return whether so many rows of a source were left out that the log is not useful: at least 5 and above 5 %."""
    return too_many_rows_missing(row.n, row.n_rows)


def _files_of_logs(import_map: ImportMap, files: Sequence[Path]) -> list[tuple[str, list[tuple[Path, Source]]]]:
    """Return for each log of an import its name without ending, and its source files, each with its [[file]] table.

    If the import map has no [[file]] table, each file makes its own log and gets the only source of the map; the log of
    a file that is alone in a given folder has the name of the folder. Otherwise the files of each folder make one log
    with the name of the folder, and all other files together one with the name of the map. Files of a folder that no
    [[file]] matches are left out. Raise SeatrialError if a [[file]] does not match exactly one file, or a file that was
    given exactly one [[file]].
    """
    require_sources(files)
    found: list[tuple[str, list[tuple[Path, Source]]]] = []
    if not import_map.merge:
        for path in files:
            inner = tables_of_folder(path) if is_run_folder(path) else [path]
            if not inner:
                raise SeatrialError(f"{path}: has no file that import reads; give the folder of a run, or a file")
            is_alone = inner != [path] and len(inner) == 1
            found += [
                (name_of_folder(path) if is_alone else file.stem, [(file, import_map.sources[0])]) for file in inner
            ]
        return found
    loose = [path for path in files if not is_run_folder(path)]
    for path in files:
        if is_run_folder(path):
            found.append((name_of_folder(path), _files_of_run(import_map, files_of_folder(path), path)))
        elif path == loose[0]:
            found.append((import_map.path.stem, _files_of_run(import_map, loose, None)))
    return found


def _files_of_run(import_map: ImportMap, files: Sequence[Path], folder: Path | None) -> list[tuple[Path, Source]]:
    """Return the source files of one log with their [[file]] tables, in the order of these tables.

    `files` are those in `folder`, or those that were given without one (None). Raise SeatrialError if a [[file]] does
    not match exactly one file, or a file without a folder exactly one [[file]].
    """
    group = []
    for source in import_map.sources:
        matching = [path for path in files if fnmatch(path.name, source.match)]
        if len(matching) != 1:
            shown = ", ".join(map(str, matching)) or "none"
            of = "the given files" if folder is None else f"the files in {folder}"
            folders = dict.fromkeys(str(path.parent) for path in matching)
            runs = f"; for several runs, give their folders: {', '.join(folders)}" if len(folders) > 1 else ""
            raise SeatrialError(
                f"{import_map.path}: [[file]] match = '{source.match}' must match exactly one of {of}; correct it, as "
                f"it matches: {shown}{runs}"
            )
        group.append((matching[0], source))
    used = [path for path, _ in group]
    for path in files:
        if used.count(path) > 1 or (folder is None and path not in used):
            raise SeatrialError(
                f"{import_map.path}: {path} must match exactly one [[file]], and it matches {used.count(path)}; "
                "correct match in [[file]]"
            )
    return group


class _SourceFile(NamedTuple):
    """Contents of one source file of an import.

    Attributes
    ----------
    path : Path
        The file.
    kind : str
        Name of the kind of source, for example "csv" or "ros".
    sha256 : str
        Digest of the file, or of all files of a folder.
    signals : Signals
        Signals of the file, and the rows that were left out.
    origin : float
        Time that is added to the times of the file [s since 1970].
    remarks : tuple of str
        Remarks for the user, which become warnings.
    events : tuple
        Events of the source, each with its time [s of the file's clock, before `origin` is added].
    """

    path: Path
    kind: str  # name of the kind of source, as csv or ros
    sha256: str
    signals: Signals
    origin: float  # s since 1970, added to its times
    remarks: tuple[str, ...]  # shown as warnings
    events: tuple[tuple[float, Event], ...] = ()  # with their times [s of the file's clock]


def _read_source(path: Path, source: Source) -> _SourceFile:
    """Read one source file by its part of the import map (`source`), and collect the remarks about it.

    Remarks are about tables whose topic is in the map, rows left out (unless so many that the import fails afterwards,
    or because of wrong stamps, of which the table has a remark), held values, times at which inputs are unknown, and
    signals without samples. Raise SeatrialError if the file cannot be read by the map. A remark about the times of such
    a table also becomes an event at its first time.
    """
    kind = source_kind(path)
    tables = kind.read(path, source.options)
    signals = read_signals(tables, source)
    used = {signal.topic for signal in source.signals}
    remarks = [
        f"{path}: {line}"
        for line in _remarks_by_topic([table for table in tables if table.full_remark and table.topic in used])
    ]
    remarks += [f"{path}: {rows.text}" for rows in signals.left_out if rows.why != "stamps" and not _is_too_many(rows)]
    remarks += [f"{path}: {line}" for line in held_lines(signals.held)]
    gaps = {data.signal.name: unknown_times(data.t, data.values) for data in signals.signals if data.has_gaps}
    remarks += [f"{path}: {line}" for line in gap_lines(gaps)]
    empty = [data.signal.name for data in signals.signals if not len(data.t)]
    if empty:
        advice = "check their column, nan and missing in the import map"
        remarks.append(f"{path}: not in the log, because they have no samples: {', '.join(empty)}; {advice}")
    origin = source.time.origin if source.time else 0.0
    events = tuple(event for table in tables for event in table.events)
    for table in tables:
        if table.clock and table.topic in used and table.t is not None and len(table.t):
            events += ((float(table.t[0]), Event("clock", f"{table.topic or path.name}: {table.clock}")),)
    return _SourceFile(path, kind.name, sha256_of(path), signals, origin, tuple(remarks), events)


def _remarks_by_topic(tables: Sequence[Table]) -> list[str]:
    """Return the remarks of tables as lines for the user. A remark that several tables share is one line.

    Each line begins with the topics of its tables, if they have topics. A remark that all of several tables share is
    about the file, and its line has no topics. The lines are in the order of the tables.
    """
    topics: dict[str, list[str]] = {}
    for table in tables:
        topics.setdefault(table.full_remark.removeprefix(f"{table.topic}: "), []).append(table.topic)
    shared = len(tables) if len(tables) > 1 else 0
    named = [("" if len(names) == shared else ", ".join(names), text) for text, names in topics.items()]
    return [": ".join(filter(None, line)) for line in named]


def held_lines(held: Sequence[Held]) -> list[str]:
    """Return a line for each group of signals that the source repeats together until their next measurement.

    The line has the interval of the measurements and the number of repeats left out.

    Parameters
    ----------
    held
        The signals whose values the source holds (repeats in each row until the next measurement).

    Returns
    -------
    list of str
        The lines. Signals with equal numbers of samples and repeats are one group.
    """
    groups: dict[tuple[int, int], list[Held]] = {}
    for signal in held:
        groups.setdefault((signal.n, signal.n_left_out), []).append(signal)
    return [
        f"{', '.join(signal.name for signal in group)}: held between measurements {group[0].interval:.3g} s apart; "
        f"{n_left_out} of {n} values repeat the previous value and are left out"
        for (n, n_left_out), group in groups.items()
    ]


def left_out_line(row: RowsLeftOut) -> str:
    """Return the number of rows left out as a line of the log's metadata: "number rows why rate topic".

    The check of the log parses this line. For example "12 4000 repeats 50 imu" are 12 of 4000 rows of the topic imu,
    left out because their stamp repeats, at 50 Hz.
    """
    return f"{row.n} {row.n_rows} {row.why} {row.rate:.6g} {row.topic}"


def _files_named_in_map(import_map: ImportMap) -> list[Path]:
    """Return the DBC and rig files that an import map names. An import must not replace them by a log."""
    named = [path for source in import_map.sources for path in (source.options.dbc, source.options.rig)]
    return [path for path in named if path is not None]


def _write_piece(
    import_map: ImportMap,
    run: str,
    data: Sequence[_SourceFile],
    piece: Piece,
    target: Path,
    force: bool,
    reads: Sequence[Path],
    shift: float,
) -> None:
    """Write one log, `target`: the signals and events of the source files within one interval of time (`piece`).

    An event exactly at an end of the interval is included. The signals and events are shifted by the origin of their
    file to s since 1970. The metadata contain the name of the `run`, the digests of the import map and the files, the
    numbers of rows left out, and the shift [s] of times that begin below zero, which the origins contain already. The
    map and the known numbers of the boat in it are attached. An existing log is replaced only with `force`; the files
    `reads` (map and sources) are never replaced.
    """
    signals: list[SignalData] = []
    events = [
        (t + source_file.origin, event)
        for source_file in data
        for t, event in source_file.events
        if piece.t_from <= t <= piece.t_to
    ]
    kinds = ", ".join(dict.fromkeys(source_file.kind for source_file in data))
    metadata = {"import": kinds, "import.map": import_map.name, "import.map.sha256": _sha256(import_map.text)}
    metadata["import.run"] = run
    if shift:
        metadata["import.time_shift_s"] = repr(shift)
    for i, source_file in enumerate(data, start=1):
        metadata[f"source.{i}.name"] = source_file.path.name
        metadata[f"source.{i}.sha256"] = source_file.sha256
        metadata[f"source.{i}.dropped"] = str(source_file.signals.n_dropped)
        metadata[f"source.{i}.disordered"] = str(source_file.signals.n_disordered)
        metadata[f"source.{i}.left_out"] = "\n".join(left_out_line(row) for row in source_file.signals.left_out)
        metadata[f"source.{i}.held"] = "; ".join(held_lines(source_file.signals.held))
        for signal in source_file.signals.signals:
            cut = _within_piece(signal, piece)
            signals.append(replace(cut, t=cut.t + source_file.origin))
    names = ", ".join(source_file.path.name for source_file in data)
    note = f"{names} by {import_map.path.name}" + (f", {piece.name}" if piece.name else "")
    note += f", times shifted by {shift:.6g} s" if shift else ""
    attachments = {"import.toml": import_map.text.encode()}
    if import_map.vehicle:
        attachments["vehicle.toml"] = "".join(f"{k} = {v!r}\n" for k, v in import_map.vehicle.items()).encode()
    write_signals(
        target, signals, metadata=metadata, attachments=attachments, note=note, events=events, force=force, reads=reads
    )


def _within_piece(signal: SignalData, piece: Piece) -> SignalData:
    """Return the samples of a signal within an interval of time (t_from <= t <= t_to, in s of the file's clock).

    A held signal (hold = "zero") also gets its last value before the interval as a sample at t_from, unless it has a
    sample exactly there. If it has samples after the interval, or a timeout, its last value within the interval also
    becomes a sample at t_to, unless it has a sample exactly there. No sample is added at an end without a limit.
    """
    inside = (signal.t >= piece.t_from) & (signal.t <= piece.t_to)
    t, values = signal.t[inside], signal.values[inside]
    before = np.flatnonzero(signal.t < piece.t_from)
    if signal.signal.hold == "zero" and len(before) and not (len(t) and t[0] == piece.t_from):
        # The last command before the piece still holds at its beginning.
        t, values = np.insert(t, 0, piece.t_from), np.insert(values, 0, signal.values[before[-1]])
    known_after = bool(np.any(signal.t > piece.t_to)) or signal.signal.timeout > 0.0
    if signal.signal.hold == "zero" and len(t) and t[-1] < piece.t_to < _WHOLE.t_to and known_after:
        # The last command within the piece holds to its end.
        t, values = np.append(t, piece.t_to), np.append(values, values[-1])
    return replace(signal, t=t, values=values)


def _sha256(text: str) -> str:
    """Return the SHA-256 of the text of an import map in UTF-8, as hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()
