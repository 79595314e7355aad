"""Variables of MATLAB files as Python values: structs, struct arrays, cells, text, and objects of version 7.3.

Files of version 5 to 7 are read by scipy. Files of version 7.3 are HDF5: a struct is a group, a struct array is a group
whose fields are references, a cell is an array of references. An object (datetime, duration, table, timetable,
timeseries) is an index of the list ``/#subsystem#/MCOS``. The first entry of this list contains, as 32-bit words, the
class of each object and the entries with its properties. MathWorks does not publish this layout; the source is
https://github.com/foreverallama/matio (docs/mcos.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError

OBJECT = 0xDD000000  # first word of a reference to an object
DEEPEST = 30  # deepest nesting of structs, cells and objects
MOST_STRUCTS = 16  # elements of a struct array that become topics of their own
_HEADER_BYTES = 40  # header of the list of objects: version, number of names, ends of 8 regions
_CONTENTS = 2  # entries of the list before the properties
TABLES = ("table", "timetable")


@dataclass(frozen=True)
class MatlabObject:
    """Object of a MATLAB class, read from a file of version 7.3. An object of an older file has no properties.

    Attributes
    ----------
    kind : str
        Name of its class, for example "datetime" or "timetable"; a text for the user in an older file.
    properties : dict
        Properties of the object, by name.
    """

    kind: str  # name of its class
    properties: Mapping[str, Any]  # by name


class Vector(NamedTuple):
    """Array of numbers in a variable of a MATLAB file, with the topic and the name of the column that it becomes.

    Attributes
    ----------
    topic : str
        Topic of the table, for example the name of the variable; "" for a variable of the workspace itself.
    name : str
        Name of the column.
    values : Array
        The numbers, as a vector, a matrix or an array of more dimensions.
    unit : str
        Unit that the file states; "" if none.
    is_time : bool
        Whether the values are times [s]; a datetime counts since 1970.
    """

    topic: str
    name: str
    values: NDArray[Any]  # (n,) or a matrix
    unit: str = ""
    is_time: bool = False  # whether the values are times [s]; a datetime counts since 1970


def vectors(name: str, value: Any, left_out: list[str], topic: str = "", depth: int = 0) -> Iterator[Vector]:
    """Yield the arrays of real numbers in a variable of a MATLAB file, also those inside structs and objects.

    Parameters
    ----------
    name
        Name of the variable, or of the field of a struct.
    value
        Its value: array, text, dict (struct), list (cell or struct array) or MatlabObject. Text, single numbers and
        cells yield nothing, except a cell of structs only, which is read as a struct array.
    left_out
        List to which the names and classes of objects without readable numbers are added.
    topic
        Name of the variable to which the field belongs; "" for the variable itself.
    depth
        Number of structs around the value.

    Yields
    ------
    Vector
        The numbers, with their topic and name.

    Raises
    ------
    SeatrialError
        If structs are nested too deep.
    """
    place = f"{topic}.{name}" if topic else name
    if depth > DEEPEST:
        raise SeatrialError(f"{place[:60]}: structs are nested more than {DEEPEST} deep; save only the needed vectors")
    if isinstance(value, MatlabObject):
        yield from _object_vectors(name, value, left_out, topic, depth)
    elif isinstance(value, Mapping):
        if (signals := _simulink_signals(value)) is not None:
            yield from _simulink_vectors(place, name, value["time"], signals)
            return
        for field, part in value.items():
            below = name if not topic and depth == 0 else topic
            inner = field if not topic and depth == 0 else f"{name}.{field}"
            yield from vectors(inner, part, left_out, below, depth + 1)
    elif isinstance(value, list) and value and all(isinstance(element, Mapping) for element in value):
        yield from _struct_array_vectors(name, value, left_out, topic, depth)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 1:
        yield Vector(topic, name, value)


def _object_vectors(name: str, value: MatlabObject, left_out: list[str], topic: str, depth: int) -> Iterator[Vector]:
    """Yield the numbers in a MATLAB object: times, the columns of a table, or the properties of another class.

    `name` is the name of the variable or field, `topic` the variable to which the field belongs ("" for the variable
    itself), and `depth` the number of structs around the object. The name and class of an object without readable
    numbers are added to `left_out`. A single time yields nothing and is not added. The property "Data" of another class
    (a timeseries) has the name of the object.
    """
    place = f"{topic}.{name}" if topic else name
    if (seconds := _object_seconds(value)) is not None:
        if seconds.size > 1:
            yield Vector(topic, name, seconds, is_time=True)
    elif value.kind in TABLES and (columns := list(_table_columns(place, value))):
        yield from columns
    elif value.kind in (*TABLES, "string", "categorical", "calendarDuration"):
        left_out.append(f"{place} ({value.kind})")
    else:  # timeseries, and other classes with numbers in their properties
        found = [
            vector
            for field, part in value.properties.items()
            for vector in vectors(field.strip("_"), part, left_out, place, depth + 1)
        ]
        yield from (vector._replace(name=name) if vector.name.lower() == "data" else vector for vector in found)
        if not found:
            left_out.append(f"{place} ({value.kind})")


def _object_seconds(value: Any) -> NDArray[np.float64] | None:
    """Return a MATLAB datetime [s since 1970] or duration [s] as an array; None for values of other classes.

    A datetime with a zone is in UTC. A datetime without a value in the file is NaN, a duration without one is 0.
    """
    if not isinstance(value, MatlabObject) or value.kind not in ("datetime", "duration"):
        return None
    milliseconds = value.properties.get("data" if value.kind == "datetime" else "millis")
    if not isinstance(
        milliseconds, np.ndarray
    ):  # the file does not contain default values: a duration of 0 s, no datetime
        return np.zeros(1) if value.kind == "duration" else np.full(1, np.nan)
    # A datetime is a complex number: the imaginary part is the remainder below the resolution of the real part.
    return np.asarray(1e-3 * milliseconds.real + 1e-3 * milliseconds.imag, np.float64)


def _table_columns(place: str, value: MatlabObject) -> Iterator[Vector]:
    """Yield the columns of numbers of a MATLAB table or timetable. The times of a timetable come first.

    `place` is the name of the variable, which becomes the topic. Columns of datetime or duration are in s. Columns of
    text and of other classes, and columns of a single number, are left out. The times of a timetable are left out if
    their number differs from that of the rows, or if all are NaN. Nothing is yielded if the object has another layout.
    """
    inner = value.properties.get("any", value.properties)
    if not isinstance(inner, Mapping):
        return
    data = inner.get("data")
    names = inner.get("varNames", inner.get("varnames"))
    if not isinstance(data, list) or not isinstance(names, list) or len(names) != len(data):
        return
    n_rows = int(_single_number(inner.get("numRows", inner.get("nrows"))) or 0)
    if value.kind == "timetable":
        dimensions = inner.get("dimNames")
        time_name = dimensions[0] if isinstance(dimensions, list) and dimensions else "Time"
        t = _row_times(inner.get("rowTimes"), n_rows)
        if t is not None and len(t) == n_rows and np.isfinite(t).any():
            yield Vector(place, str(time_name), t, is_time=True)
    properties = inner.get("props")
    units = inner.get("varUnits", properties.get("VariableUnits") if isinstance(properties, Mapping) else None)
    units = units if isinstance(units, list) and len(units) == len(names) else [""] * len(names)
    for name, column, unit in zip(names, data, units, strict=True):
        seconds = _object_seconds(column)
        values = column if seconds is None else seconds
        if isinstance(values, np.ndarray) and values.dtype.kind in "biuf" and values.size > 1:
            unit = unit if isinstance(unit, str) else ""
            yield Vector(place, str(name), values, unit, seconds is not None)


def _row_times(value: Any, n_rows: int) -> NDArray[np.float64] | None:
    """Return the times of the rows of a MATLAB timetable, (n_rows,) [s]; None if their kind is unknown.

    Dates count from 1970. Times that are stored one by one are returned as they are, so their number may differ from
    `n_rows`. `value` has the times as a datetime or duration, or as a struct of a first time with a step or a rate.
    """
    if (seconds := _object_seconds(value)) is not None:
        return seconds.ravel()
    if not isinstance(value, Mapping):
        return None
    origin, step = _object_seconds(value.get("origin")), _object_seconds(value.get("stepSize"))
    rate = _single_number(value.get("sampleRate"))
    if origin is None or not origin.size:
        return None
    is_rate = _single_number(value.get("specifiedAsRate"))
    if step is not None and step.size and step.flat[0] > 0.0 and not is_rate:
        return np.asarray(origin.flat[0] + step.flat[0] * np.arange(n_rows), np.float64)
    if rate and is_rate:
        return np.asarray(origin.flat[0] + np.arange(n_rows) / rate, np.float64)
    return None


def _single_number(value: Any) -> float | None:
    """Return the number in a MATLAB array of one real number or logical (true is 1); None for any other value."""
    ok = isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "biuf"
    return float(value.flat[0]) if ok else None


def _simulink_signals(value: Mapping[str, Any]) -> list[Mapping[str, Any]] | None:
    """Return the signals of a Simulink structure with time (a struct as a dict), each a dict with "values".

    Return None for any other struct, and for one with fewer than two times.
    """
    signals, time = value.get("signals"), value.get("time")
    listed = [signals] if isinstance(signals, Mapping) else signals
    if not isinstance(time, np.ndarray) or time.size < 2 or not isinstance(listed, list) or not listed:
        return None
    if not all(isinstance(signal, Mapping) and "values" in signal for signal in listed):
        return None
    return listed


def _simulink_vectors(place: str, name: str, time: Any, signals: list[Mapping[str, Any]]) -> Iterator[Vector]:
    """Yield the times and the signals of a Simulink structure with time as columns of the topic `place`.

    `time` has the times (n,) [s]. Each signal is a dict with "values". The column of a signal is named after the label
    of the signal. A single signal without a label has the name of the variable (`name`). Of several, one without a
    label has the name of its block, or else signals[k]. Values with time along the third axis become one row for each
    time. Signals that are no arrays of numbers are left out.
    """
    t = np.ravel(time)
    yield Vector(place, "time", t)
    for k, signal in enumerate(signals):
        values = signal["values"]
        if not isinstance(values, np.ndarray) or values.dtype.kind not in "biuf":
            continue
        if values.ndim == 3 and values.shape[2] == len(t):  # a column or a matrix at each time
            values = values.reshape(-1, len(t)).T
        label, block = signal.get("label"), signal.get("blockName")
        signal_name = label if isinstance(label, str) and label else ""
        if not signal_name and len(signals) > 1 and isinstance(block, str):
            signal_name = block.rpartition("/")[2]
        yield Vector(place, signal_name or (name if len(signals) == 1 else f"signals[{k}]"), values)


def _struct_array_vectors(
    name: str, value: list[Mapping[str, Any]], left_out: list[str], topic: str, depth: int
) -> Iterator[Vector]:
    """Yield the arrays of numbers in a MATLAB struct array, which is a list of dicts (`value`).

    A field with one number in each struct becomes a column, with one row for each struct. The other fields are then not
    read. If the array has no such field, each of the first 16 structs becomes a topic, VARIABLE[0]. An array of one
    struct with such a field yields nothing. `name` is the variable or field, `topic` the variable to which the field
    belongs, `depth` the number of structs around it, and `left_out` collects unreadable objects.
    """
    place = f"{topic}.{name}" if topic else name
    numbers = {field: [_single_number(struct.get(field)) for struct in value] for field in value[0]}
    columns = {field: found for field, found in numbers.items() if not any(number is None for number in found)}
    for field, found in columns.items():
        if len(value) > 1:
            yield Vector(place, field, np.array(found, np.float64))
    if not columns:
        for k, struct in enumerate(value[:MOST_STRUCTS]):
            yield from vectors(f"{place}[{k}]", struct, left_out, "", depth and DEEPEST // 2)


def scipy_value(value: Any, depth: int = 0) -> Any:
    """Convert a variable from scipy.io.loadmat (squeezed) to a dict, list, text or array.

    Parameters
    ----------
    value
        The variable as scipy returns it.
    depth
        Number of structs and cells around it.

    Returns
    -------
    Any
        A dict (struct), list (cell or struct array), text or array; None for other values, and for arrays that are
        nested more than 30 deep.
    """
    if depth > DEEPEST or not isinstance(value, np.ndarray):
        return value if isinstance(value, str) else np.asarray(value) if np.isscalar(value) else None
    if value.dtype.names and type(value) is np.ndarray:
        structs = [
            {field: scipy_value(struct[field], depth + 1) for field in value.dtype.names}
            for struct in np.atleast_1d(value).flat
        ]
        return structs[0] if value.size == 1 else structs
    if value.dtype.kind == "O" and type(value) is np.ndarray:
        return [scipy_value(cell, depth + 1) for cell in value.flat]
    if value.dtype.kind == "U":
        return str(value) if value.ndim == 0 else [str(text) for text in value.flat]
    return value if value.dtype.kind in "biufc" else None


class Hdf5Variables:
    """Reader of the variables of a MATLAB file of version 7.3.

    Parameters
    ----------
    file : h5py.File
        The open file. Its list of objects is read at once, if it has one.
    """

    def __init__(self, file: Any) -> None:
        """Read the list of MATLAB objects in an open HDF5 file (version 7.3), if it has one."""
        self._file = file
        self._contents: list[Any] = []
        self._classes: list[str] = []
        self._objects: NDArray[np.uint32] = np.zeros((0, 6), np.uint32)
        self._saved: list[list[tuple[str, int, int]]] = []
        self._properties: list[list[tuple[str, int, int]]] = []
        if "#subsystem#" in file and "MCOS" in file["#subsystem#"]:
            self._contents = list(file["#subsystem#/MCOS"][()].ravel())
            self._read_objects(np.asarray(file[self._contents[0]][()], np.uint8).tobytes())

    def _read_objects(self, data: bytes) -> None:
        """Store classes, objects and properties of a MATLAB 7.3 file from `data`, the first entry of its object list.

        They are regions of 32-bit words behind a header and the names.
        """
        words = np.frombuffer(data[: len(data) // 4 * 4], "<u4")
        n_names, ends = int(words[1]), [int(end) for end in words[2:7]]
        names = [
            "",
            *(part.decode("utf-8", "replace") for part in data[_HEADER_BYTES : ends[0]].split(b"\0")[:n_names]),
        ]
        region = [words[a // 4 : b // 4] for a, b in pairwise(ends)]
        self._classes = [names[int(row[1])] for row in region[0].reshape(-1, 4)]
        self._saved, self._properties = (_property_lists(region[k], names) for k in (1, 3))
        self._objects = region[2].reshape(-1, 6)

    def items(self) -> Iterator[tuple[str, Any]]:
        """Yield the name and the value of each variable of the MATLAB file.

        Entries whose name begins with # are skipped, because they belong to MATLAB itself.
        """
        for name, node in self._file.items():
            if not name.startswith("#"):
                yield name, self._python_value(node, 0)

    def _python_value(self, node: Any, depth: int) -> Any:
        """Convert a group or dataset (`node`) of a MATLAB 7.3 file to a Python value.

        A struct becomes a dict or a list of dicts, a cell a list, text a str, an object a MatlabObject (several objects
        a list), and any other value an array, transposed to the order of MATLAB. An empty value becomes "" or an empty
        array. A value with an invalid reference to an object becomes None. `depth` is the number of structs, cells and
        objects around the value. Raise SeatrialError if it is above 30.
        """
        if depth > DEEPEST:
            raise SeatrialError(
                f"structs, cells or objects are nested more than {DEEPEST} deep; save only the needed vectors"
            )
        if hasattr(node, "items"):
            return self._struct_value(node, depth)
        kind = node.attrs.get("MATLAB_class", b"")
        if "MATLAB_empty" in node.attrs:
            return "" if kind == b"char" else np.zeros(0)
        if node.dtype.kind == "O":
            return [self._python_value(self._file[ref], depth + 1) for ref in node[()].T.ravel()]
        values = node[()]
        if "MATLAB_object_decode" in node.attrs or (kind not in _NUMERIC and _is_reference(values)):
            return self._referenced_objects(values, depth)
        if values.dtype.names == ("real", "imag"):
            return (values["real"] + 1j * values["imag"]).T
        if kind == b"char":
            return "".join(chr(code) for code in values.T.ravel())
        return np.asarray(values).T

    def _struct_value(self, group: Any, depth: int) -> Any:
        """Convert an HDF5 group of a MATLAB file: a struct to a dict by field, and a struct array to a list of dicts.

        A group is a struct array if all its fields are arrays of references without a MATLAB class. (A cell is an array
        of references too, but has the class "cell".) The struct array has as many structs as its shortest field has
        references. `depth` is the number of structs, cells and objects around the group.
        """
        is_array = [part.dtype.kind == "O" and "MATLAB_class" not in part.attrs for part in _datasets_of_group(group)]
        if not is_array or not all(is_array) or len(is_array) < len(group):
            return {field: self._python_value(part, depth + 1) for field, part in group.items()}
        columns = {field: self._python_value(part, depth + 1) for field, part in group.items()}
        n = min(len(column) for column in columns.values())
        return [{field: column[k] for field, column in columns.items()} for k in range(n)]

    def _referenced_objects(self, reference: NDArray[Any], depth: int) -> Any:
        """Return the MATLAB object of a reference, or a list of at most 16 objects; None if the reference is invalid.

        An object whose number is out of range is None. The 32-bit words of a reference are: `OBJECT`, number of
        dimensions, the dimensions, the indices of the objects, and the class. `depth` is the number of structs and
        objects around it.
        """
        words = [int(word) for word in np.ravel(reference)]
        if len(words) < 2 or words[0] != OBJECT or words[1] != len(words[2 : 2 + words[1]]):
            return None
        numbers = words[2 + words[1] : -1]
        found = [self._object_of_number(number, depth) for number in numbers[:MOST_STRUCTS]]
        return found[0] if len(found) == 1 else found

    def _object_of_number(self, number: int, depth: int) -> MatlabObject | None:
        """Return the MATLAB object that has this number in the file, from 1 on; None if the number is out of range.

        Only properties that are stored as an entry of the file are read, not those stored as a flag or an enumeration.
        `depth` is the number of structs, cells and objects around the object. Raise SeatrialError if the properties are
        nested more than 30 deep.
        """
        if not 0 < number < len(self._objects):
            return None
        kind, _, _, saved, plain, _ = (int(word) for word in self._objects[number])
        pairs = self._saved[saved] if saved else self._properties[plain]
        properties: dict[str, Any] = {}
        for name, how, value in pairs:
            if how == 1 and _CONTENTS + value < len(
                self._contents
            ):  # 1: an entry; 0: an enumeration; 2: a number or bool
                properties[name] = self._python_value(self._file[self._contents[_CONTENTS + value]], depth + 1)
        return MatlabObject(self._classes[kind], properties)


_NUMERIC = {b"double", b"single", b"logical", b"int8", b"uint8", b"int16", b"uint16", b"int32", b"int64", b"uint64"}


def _is_reference(values: Any) -> bool:
    """Return whether the values of an HDF5 dataset are the 32-bit words of a reference to a MATLAB object."""
    return bool(values.dtype == np.uint32 and values.size >= 5 and values.ravel()[0] == OBJECT)


def _datasets_of_group(group: Any) -> list[Any]:
    """Return the datasets (arrays) in a group of an HDF5 file, without the groups in it."""
    return [part for part in group.values() if not hasattr(part, "items")]


def _property_lists(words: NDArray[np.uint32], names: list[str]) -> list[list[tuple[str, int, int]]]:
    """Parse the property lists of all MATLAB objects of a file from its 32-bit words.

    Return for each object its properties: name, kind of storage (0 enumeration, 1 entry of the file, 2 number or bool),
    and value or index of the entry. The length stands in front of each list, and each list begins at an even word.
    """
    found, at = [], 0
    while at < len(words):
        n = int(words[at])
        rows = words[at + 1 : at + 1 + 3 * n].reshape(-1, 3)
        found.append([(names[int(row[0])], int(row[1]), int(row[2])) for row in rows])
        at += 1 + 3 * n
        at += at % 2
    return found
