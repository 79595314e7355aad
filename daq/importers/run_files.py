"""Runs of several files: which source files of an import belong to one run, and so become one log.

Theory of operation. A folder that is no bag of ROS is the folder of a run. Files are of one kind if most of their
columns have the same names. Files of different kinds belong to one run if their times overlap. Times that count from
the start of each file always do. Of several files of a kind they do not show to which one a file of another kind
belongs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatch
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

from seatrial.daq.errors import SeatrialError, first_names
from seatrial.daq.importers.ros import BAG_ENDINGS
from seatrial.daq.importers.sources import source_kind, text_head
from seatrial.daq.importers.text_table import sniff_style

ALIKE = 0.5  # share of common columns (of those in either file) from which two files are of one kind
LEAST_OVERLAP = 0.5  # of the shorter of two files, in time, from which they may belong to one run
MOST_NAMED = 4  # files in a line for the user
_SEPARATORS = " _-."  # between the parts of a name
_NUMBERS = re.compile(r"[\d*]+(?:[-_. T]*[\d*]+)*")  # numbers, dates and times in a name


class FileOutline(NamedTuple):
    """Columns and times of a source file.

    Attributes
    ----------
    path : Path
        The file.
    columns : frozenset
        Topic and name of each column, without the column of times.
    span : tuple of float or None
        First and last time [s]; None if the times are unknown.
    """

    path: Path
    columns: frozenset[tuple[str, str]]
    span: tuple[float, float] | None

    @property
    def is_relative(self) -> bool:
        """Whether the times count from the start of the file: they begin before they are longer than the file."""
        return self.span is not None and 0.0 <= self.span[0] < self.span[1] - self.span[0]


class RunFiles(NamedTuple):
    """Source files of one run.

    Attributes
    ----------
    name : str
        Name of the run and of its log: that of the folder, or that of the only file.
    paths : tuple of Path
        Files, each of another kind.
    kinds : tuple of int
        Number of the kind of each file, the same in all runs.
    source : Path
        Folder or file that the user gave.
    """

    name: str
    paths: tuple[Path, ...]
    kinds: tuple[int, ...]
    source: Path


class Runs(NamedTuple):
    """Runs of the sources of an import, and what was assumed to find them.

    Attributes
    ----------
    runs : list of RunFiles
        The runs, in the order of the sources.
    assumed : list of str
        A line for the user on each assumption, and on each file that is in no run.
    """

    runs: list[RunFiles]
    assumed: list[str]


def is_run_folder(path: Path) -> bool:
    """Return whether a path is a folder with files of a run, and no bag of ROS. A log among them is no bag."""
    if not path.is_dir() or (path / "metadata.yaml").exists() or any(file.suffix == ".db3" for file in path.iterdir()):
        return False
    files = files_of_folder(path)
    return any(map(_is_source, files)) if _has_bag_files(path) else bool(files)


def files_of_folder(path: Path) -> list[Path]:
    """Return the files in a folder by name, without hidden files, import maps and logs, and without folders."""
    return sorted(
        file
        for file in path.iterdir()
        if file.is_file() and not file.name.startswith(".") and file.suffix.lower() not in (".toml", *BAG_ENDINGS)
    )


def tables_of_folder(path: Path) -> list[Path]:
    """Return the files in a folder that an import can read, by name: no pictures, and no texts without a table."""
    return [file for file in files_of_folder(path) if _is_source(file)]


def _is_source(file: Path) -> bool:
    """Return whether a file is of a known kind and, if it is text, has a table of numbers."""
    try:
        return source_kind(file).name != "csv" or sniff_style(file, text_head(file)) is not None
    except SeatrialError:
        return False


def require_sources(paths: Sequence[Path]) -> None:
    """Raise SeatrialError if a path is a folder without a file, but with folders that may be those of runs."""
    for path in paths:
        if path.is_dir() and not _has_bag_files(path) and not files_of_folder(path):
            inner = sorted(folder for folder in path.iterdir() if folder.is_dir())
            if any(files_of_folder(folder) for folder in inner):
                raise SeatrialError(
                    f"{path}: has no files; give the folders in it, each with the files of one run: "
                    f"{first_names([str(folder) for folder in inner], MOST_NAMED)}"
                )


def _has_bag_files(path: Path) -> bool:
    """Return whether a folder has a file that may be a part of a bag of ROS, or a log."""
    return any(file.suffix in BAG_ENDINGS for file in path.iterdir())


def name_of_folder(path: Path) -> str:
    """Return the name of a folder, also of the current folder."""
    return path.resolve().name


def find_runs(paths: Sequence[Path], outline: Callable[[Path], FileOutline]) -> Runs:
    """Find the runs of source files and folders.

    Parameters
    ----------
    paths
        Files, folders of bags, and folders of the files of a run.
    outline
        Function that reads the columns and times of a file. Its SeatrialError for a file in a folder leaves the file
        out, since a folder of a run may also have notes and pictures.

    Returns
    -------
    Runs
        Files of one kind are runs of their own. Of files of several kinds, those whose times overlap are a run.

    Raises
    ------
    SeatrialError
        If a file that was given cannot be read, or no file of a folder.
    """
    require_sources(paths)
    assumed: list[str] = []
    groups = [(path, _readable(path, outline, assumed)) for path in paths if is_run_folder(path)]
    loose = [outline(path) for path in paths if not is_run_folder(path)]
    kinds = _Kinds()
    order = {path: k for k, path in enumerate(paths)}
    runs = [run for path, files in groups for run in _runs_of_group(files, kinds, path, assumed)]
    if loose:
        runs += _runs_of_group(loose, kinds, None, assumed)
    return Runs(sorted(runs, key=lambda run: order[run.source]), list(dict.fromkeys(assumed)))


def _readable(folder: Path, outline: Callable[[Path], FileOutline], assumed: list[str]) -> list[FileOutline]:
    """Return the outlines of the files of a folder. Files that cannot be read are left out, with a line in `assumed`.

    Raise SeatrialError if no file can be read.
    """
    found, problems = list[FileOutline](), dict[Path, SeatrialError]()
    for file in files_of_folder(folder):
        try:
            found.append(outline(file))
        except SeatrialError as problem:
            problems[file] = problem
    if not found:
        raise next(iter(problems.values()))
    if problems:
        names = first_names([str(file) for file in problems], MOST_NAMED)
        assumed.append(f"{names}: left out, as {'it is no table' if len(problems) == 1 else 'they are no tables'}")
    return found


class _Kinds:
    """Kinds of files, by their columns."""

    def __init__(self) -> None:
        """Begin without kinds."""
        self._columns: list[frozenset[tuple[str, str]]] = []

    def of(self, file: FileOutline) -> int:
        """Return the number of the kind of a file: the most similar one, or a new one if none is similar."""
        shares = [len(file.columns & known) / (len(file.columns | known) or 1) for known in self._columns]
        best = max(range(len(shares)), key=shares.__getitem__, default=0)
        if not shares or (shares[best] < ALIKE and file.columns != self._columns[best]):
            self._columns.append(file.columns)
            return len(self._columns) - 1
        return best


def _runs_of_group(
    files: Sequence[FileOutline], kinds: _Kinds, folder: Path | None, assumed: list[str]
) -> Iterator[RunFiles]:
    """Yield the runs of the files of one folder, or of all files that were given without one (`folder` is None).

    Each file of the kind with the most files begins a run. It gets the file of each other kind whose times overlap with
    its own most. A file that is left then is a run of its own, but not in a folder. Lines on assumptions are appended
    to `assumed`.
    """
    by_kind: dict[int, list[FileOutline]] = {}
    for file in files:
        by_kind.setdefault(kinds.of(file), []).append(file)
    lead = max(by_kind, key=lambda kind: len(by_kind[kind]))
    used: set[Path] = set()
    first: list[FileOutline] = []  # files that began a run
    together: list[RunFiles] = []  # runs of several files
    doubtful: dict[str, list[str]] = {}  # pairs of files by the reason for which they are of one run
    for k, file in enumerate(by_kind[lead]):
        members = {lead: file}
        for kind, others in by_kind.items():
            if kind != lead and (other := _file_of_run(file, others, k, len(by_kind[lead]), doubtful)):
                members[kind] = other
        again = [other for kind, other in members.items() if kind != lead and other.path in used]
        twin = next((before for before in first if again and _overlap(before, file) >= LEAST_OVERLAP), None)
        if twin is not None:
            assumed.append(
                f"{file.path}: left out, as it has the columns and the times of {twin.path.name}; add its signals to "
                "the map by hand if they are of another sensor"
            )
            used.add(file.path)
            continue
        first.append(file)
        used.update(other.path for other in members.values())
        in_order = sorted(members.items(), key=lambda member: files.index(member[1]))
        paths = tuple(other.path for _, other in in_order)
        is_alone = folder is not None and len(by_kind[lead]) == 1
        name = ("" if is_alone else _name_of(paths)) or name_of_folder(folder or paths[0].parent)
        run = RunFiles(name, paths, tuple(kind for kind, _ in in_order), folder or paths[0])
        together += [run] * (len(paths) > 1)
        yield run
    for other in (file for file in files if file.path not in used):
        if folder is None:
            yield RunFiles(other.path.stem, (other.path,), (kinds.of(other),), other.path)
            continue
        why = "are unknown" if other.span is None else f"do not overlap with those of {first[0].path.name}"
        advice = "guess its map alone, or give the origin of its times in a map by hand"
        if other.is_relative and len(first) > 1 and all(file.is_relative for file in first):
            why = f"count from its start, as those of {first[0].path.name} and {len(first) - 1} more of other columns"
            advice = "if it is a recording of its own, guess its map alone; if it is of one of these runs, move the "
            advice += "files of each run to a folder of their own"
        assumed.append(f"{other.path}: left out, as its times {why}; {advice}")
    assumed += [
        f"{first_names(pairs, MOST_NAMED)}: assumed to be of one run by {reason}, as further files overlap too"
        for reason, pairs in doubtful.items()
    ]
    if len(together) > 1:
        parents = list(dict.fromkeys(path.parent for run in together for path in run.paths))
        advice = "move each run to a folder of its own, and import the folders"
        if len(parents) == len(together):
            advice = f"import their folders: {first_names([str(parent) for parent in parents], MOST_NAMED)}"
        where = "the files" if folder is None else f"the files in {folder}"
        assumed.append(f"{where} are {len(together)} runs of several files; {advice}")


def _file_of_run(
    file: FileOutline, others: Sequence[FileOutline], k: int, n_runs: int, doubtful: dict[str, list[str]]
) -> FileOutline | None:
    """Return the file of another kind (`others`) that is of the same run as a file; None if there is none.

    If several overlap with it, as with times that count from the start of each file, the k-th of as many files as runs
    (`n_runs`) is taken, or else the one with the longest overlap. Both files are then appended to `doubtful`, by the
    reason. If such times are those of fewer files than runs, they are of no run: files of equal columns are runs, and
    an overlap does not show to which of them another file belongs.
    """
    if len(others) < n_runs and file.is_relative:
        others = [other for other in others if not other.is_relative]
    overlaps = [_overlap(file, other) for other in others]
    good = [i for i, overlap in enumerate(overlaps) if overlap >= LEAST_OVERLAP]
    if not good:
        return None
    if len(good) == 1:
        return others[good[0]]
    by_order = len(others) == n_runs and k in good
    best = k if by_order else max(good, key=lambda i: _common_time(file, others[i]))
    reason = "their order" if by_order else "the longest common time"
    doubtful.setdefault(reason, []).append(f"{file.path.name} with {others[best].path.name}")
    return others[best]


def _common_time(one: FileOutline, other: FileOutline) -> float:
    """Return the time that two files have in common [s]; 0 if the times of one are unknown."""
    if one.span is None or other.span is None:
        return 0.0
    return max(0.0, min(one.span[1], other.span[1]) - max(one.span[0], other.span[0]))


def _overlap(one: FileOutline, other: FileOutline) -> float:
    """Return the common time of two files as a share of the shorter one, 0 to 1; 0 if the times of one are unknown."""
    if one.span is None or other.span is None:
        return 0.0
    return _common_time(one, other) / (min(one.span[1] - one.span[0], other.span[1] - other.span[0]) or 1.0)


def _name_of(paths: Sequence[Path]) -> str:
    """Return the name of a run of files without a folder of their own: the begin of all names, before a separator.

    The name of a single file is its own. It is empty if the names have no such begin, as those of sensors.
    """
    if len(paths) == 1:
        return paths[0].stem
    begin = _common_begin([path.stem for path in paths])
    return begin.rstrip(_SEPARATORS) if begin.endswith(tuple(_SEPARATORS)) else ""


def match_pattern(own: Sequence[Path], others: Sequence[Path]) -> str:
    """Return a pattern of `fnmatch` for the names of the files of one kind.

    Parameters
    ----------
    own
        Files of the kind.
    others
        Files of the other kinds. The pattern must not match them.

    Returns
    -------
    str
        What the names share, without numbers, as ``*_gnss.csv`` of 2026-06-01_gnss.csv. If this matches another kind,
        the names as they are, with a star where they differ.
    """
    names = list(dict.fromkeys(path.name for path in own))
    begin = _common_begin(names)
    end = _common_begin([name[len(begin) :][::-1] for name in names])[::-1] if len(names) > 1 else ""
    exact = _escaped(names[0]) if len(names) == 1 else f"{_escaped(begin)}*{_escaped(end)}"
    stem, dot, ending = exact.rpartition(".")
    general = f"{_NUMBERS.sub('*', stem)}{dot}{ending}"
    fits = all(fnmatch(name, general) for name in names) and general.strip("*") != f".{ending}"
    return general if fits and not any(fnmatch(path.name, general) for path in others) else exact


def _escaped(text: str) -> str:
    """Return a text as a pattern of `fnmatch` that only this text matches."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in text)


def _common_begin(texts: Sequence[str]) -> str:
    """Return the characters with which all texts begin."""
    return "".join(
        letters[0] for letters in takewhile(lambda letters: len(set(letters)) == 1, zip(*texts, strict=False))
    )
