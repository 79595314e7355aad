"""Tests of the import of MATLAB 7.3 objects, struct arrays, and Simulink's structures with time."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import seatrial as st
from seatrial.daq.errors import SeatrialError, SeatrialWarning
from seatrial.daq.importers.columnar import read_matlab
from seatrial.daq.importers.guess import guess_map
from seatrial.daq.importers.import_files import import_files
from seatrial.daq.importers.table import SourceOptions, Table
from tests.daq.csv_files import values

N = 50
T = 0.1 * np.arange(N)
YAW, LEFT, RIGHT = 0.2 * T, 0.5 * np.sin(T), 0.5 * np.cos(T)
SIGNALS = {"yaw": YAW, "n_left": LEFT, "n_right": RIGHT, "x": 3.0 * T, "y": -T}


class ObjectFile:
    """Writer of a MATLAB 7.3 file with objects. Their classes and properties are in /#subsystem#/MCOS."""

    def __init__(self, file: Any) -> None:
        self.file = file
        self.refs = file.create_group("#refs#")
        self.n_refs = 0
        self.names: list[str] = []
        self.classes: list[str] = []
        self.objects: list[tuple[int, int]] = []  # class and list of properties
        self.properties: list[list[tuple[int, int]]] = []  # name and content
        self.contents: list[Any] = []

    def name(self, text: str) -> int:
        if text not in self.names:
            self.names.append(text)
        return self.names.index(text) + 1

    def free(self) -> str:
        """Return a name in #refs# that is free."""
        self.n_refs += 1
        return f"r{self.n_refs}"

    def write(self, group: Any, name: str, value: Any) -> Any:
        """Write a value: text, cell (list), struct (dict), object (class and dict) or numbers."""
        if isinstance(value, dict):
            made = group.create_group(name)
            made.attrs["MATLAB_class"] = np.bytes_(b"struct")
            for field, part in value.items():
                self.write(made, field, part)
            return made
        if isinstance(value, tuple):
            reference = self.object(*value)
            made = group.create_dataset(name, data=np.array([reference], np.uint32))
            made.attrs["MATLAB_class"] = np.bytes_(value[0].encode())
            made.attrs["MATLAB_object_decode"] = np.int32(3)
            return made
        if isinstance(value, list):
            parts = [self.write(self.refs, self.free(), part).ref for part in value]
            made = group.create_dataset(name, data=np.array([parts], dtype=h5py.ref_dtype).T, dtype=h5py.ref_dtype)
            made.attrs["MATLAB_class"] = np.bytes_(b"cell")
            return made
        if isinstance(value, str):
            made = group.create_dataset(name, data=np.array([[ord(c)] for c in value], np.uint16))
            made.attrs["MATLAB_class"] = np.bytes_(b"char")
            return made
        made = group.create_dataset(name, data=np.atleast_2d(value).astype(np.float64))
        made.attrs["MATLAB_class"] = np.bytes_(b"double")
        return made

    def object(self, kind: str, properties: dict[str, Any]) -> list[int]:
        self.name(kind)
        if kind not in self.classes:
            self.classes.append(kind)
        pairs = []
        for name, value in properties.items():
            made = self.write(self.refs, self.free(), value)
            pairs.append((self.name(name), len(self.contents)))
            self.contents.append(made.ref)
        self.properties.append(pairs)
        self.objects.append((self.classes.index(kind) + 1, len(self.properties)))
        return [0xDD000000, 2, 1, 1, len(self.objects), self.classes.index(kind) + 1]

    def close(self) -> None:
        names = b"".join(name.encode() + b"\0" for name in self.names)
        names += bytes(-len(names) % 8)
        classes = [0, 0, 0, 0, *(word for name in self.classes for word in (0, self.name(name), 0, 0))]
        saved = [0, 0]  # the object has no properties from saveobj
        objects = [0] * 6 + [w for n, (kind, one) in enumerate(self.objects, 1) for w in (kind, 0, 0, 0, one, n)]
        plain = [0, 0]
        for pairs in self.properties:
            plain += [len(pairs), *(word for name, content in pairs for word in (name, 1, content))]
            plain += [0] * (len(plain) % 2)
        regions = [struct.pack(f"<{len(words)}I", *words) for words in (classes, saved, objects, plain)]
        ends = np.cumsum([40 + len(names), *(len(region) for region in regions)]).tolist()
        header = struct.pack("<10I", 4, len(self.names), *ends, *[ends[-1]] * 3)
        data = np.frombuffer(header + names + b"".join(regions), np.uint8)
        first = self.refs.create_dataset("metadata", data=data[None])
        empty = self.refs.create_dataset("empty", data=np.zeros(2, np.uint64))
        all_refs = np.array([[first.ref, empty.ref, *self.contents]], dtype=h5py.ref_dtype)
        self.file.create_group("#subsystem#").create_dataset("MCOS", data=all_refs, dtype=h5py.ref_dtype)


def save_objects(path: Path, **variables: Any) -> Path:
    with h5py.File(path, "w", userblock_size=512) as file:
        objects = ObjectFile(file)
        for name, value in variables.items():
            objects.write(file, name, value)
        objects.close()
    with path.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    return path


def timetable(row_times: Any, **columns: Any) -> tuple[str, dict[str, Any]]:
    inner = {
        "data": [*columns.values()], "varNames": [*columns], "varUnits": ["deg", "", ""][: len(columns)],
        "dimNames": ["Time", "Variables"], "numRows": float(N), "rowTimes": row_times,
    }  # fmt: skip
    return "timetable", {"any": inner}


def by_topic(path: Path) -> dict[str, Table]:
    return {table.topic: table for table in read_matlab(path, SourceOptions())}


MOMENTS = 1715504400.0 + T


@pytest.mark.parametrize(
    ("row_times", "t"),
    [
        (("datetime", {"data": 1e3 * MOMENTS, "tz": "", "fmt": ""}), MOMENTS),
        (("duration", {"millis": 1e3 * T, "fmt": "s"}), T),
        ({"origin": ("duration", {"millis": 5e3}), "specifiedAsRate": 1.0, "sampleRate": 10.0}, 5.0 + T),
        ({"origin": ("duration", {"fmt": "s"}), "specifiedAsRate": 0.0, "sampleRate": 1.0,
          "stepSize": ("duration", {"millis": 100.0})}, T),
    ],
)  # fmt: skip
def test_a_timetable_of_version_7_3_is_imported(row_times: Any, t: np.ndarray, tmp_path: Path) -> None:
    path = save_objects(tmp_path / "run.mat", TT=timetable(row_times, yaw=YAW, n_left=LEFT, n_right=RIGHT))
    guess = guess_map(path)
    assert guess.problem == ""
    (tmp_path / "map.toml").write_text(guess.text)
    (out,) = import_files(tmp_path / "map.toml", [path], out=tmp_path / "run.mcap")
    found, psi = values(out, "psi")
    np.testing.assert_allclose(found, t, atol=2e-7)
    np.testing.assert_allclose(psi, np.radians(YAW))  # in the unit of the timetable


def test_other_objects_of_version_7_3_are_imported(tmp_path: Path) -> None:
    path = save_objects(
        tmp_path / "run.mat",
        when=("datetime", {"data": 1e3 * MOMENTS}),
        log={"T": ("table", {"data": [YAW, LEFT], "varnames": ["yaw", "n_left"], "nrows": float(N)})},
        rpm=("timeseries", {"Time_": T, "Data_": 900.0 * LEFT}),
        words=("categorical", {"codes": np.arange(5.0)}),
    )
    tables = by_topic(path)
    np.testing.assert_allclose(tables[""].numbers("when"), MOMENTS, atol=2e-7)
    assert tables[""].seconds == {"when"}
    np.testing.assert_allclose(tables["log.T"].numbers("yaw"), YAW)
    np.testing.assert_allclose(tables["rpm"].numbers("rpm"), 900.0 * LEFT)
    np.testing.assert_allclose(tables["rpm"].numbers("Time"), T)
    fault = "left out, of a class that cannot be read: words (categorical); save them as numbers"
    assert next(iter(tables.values())).remark == fault


def test_references_without_an_object_are_not_read_as_numbers(tmp_path: Path) -> None:
    """An earlier version read a reference to another value as six numbers."""
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        made = file.create_dataset("TT", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32))
        made.attrs["MATLAB_class"] = np.bytes_(b"timetable")
        made.attrs["MATLAB_object_decode"] = np.int32(3)
    with path.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file".ljust(512))
    with pytest.raises(
        SeatrialError, match=r"contains no vectors of numbers; objects .* are read only from files of version 7\.3"
    ):
        read_matlab(path, SourceOptions())


def scope(time: np.ndarray, signals: dict[str, np.ndarray]) -> dict[str, Any]:
    kind = [("values", object), ("dimensions", object), ("label", object)]
    made = np.empty((1, len(signals)), dtype=kind)
    for k, (name, one) in enumerate(signals.items()):
        made[0, k] = (one[:, None], np.array([[1.0]]), name)
    return {"time": time[:, None], "signals": made, "blockName": "boat/Scope"}


def test_a_structure_with_time_of_a_scope_is_imported(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"ScopeData": scope(T, SIGNALS)})
    guess = guess_map(path)
    assert guess.problem == ""
    (tmp_path / "map.toml").write_text(guess.text)
    (out,) = import_files(tmp_path / "map.toml", [path], out=tmp_path / "run.mcap")
    for name, value in (("psi", YAW), ("x", 3.0 * T), ("n_right", RIGHT)):
        np.testing.assert_allclose(values(out, name), (T, value), atol=1e-12)


def test_structures_with_time_of_one_signal_each_share_their_table(tmp_path: Path) -> None:
    """x and y of two To Workspace blocks are one position. A block with another rate stays separate."""
    path = tmp_path / "run.mat"
    blocks = {
        name: {"time": T[:, None], "signals": {"values": value.reshape(1, 1, -1), "dimensions": 1.0, "label": ""}}
        for name, value in SIGNALS.items()
    }
    blocks["volts"] = {"time": T[::2, None], "signals": {"values": 12.0 + T[::2, None], "dimensions": 1.0, "label": ""}}
    savemat(path, blocks)
    tables = by_topic(path)
    assert {topic: set(table.names) for topic, table in tables.items()} == {
        "": {"time", *SIGNALS}, "volts": {"time", "volts"},
    }  # fmt: skip
    np.testing.assert_allclose(tables[""].numbers("x"), 3.0 * T)
    assert '{ name = "y", column = "y", unit = "m" }' in guess_map(path).text


def test_a_struct_array_has_a_column_for_each_field(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    rows = np.zeros((1, N), dtype=[("t", object), ("yaw", object)])
    for k in range(N):
        rows[0, k] = (T[k], YAW[k])
    savemat(path, {"log": rows})
    table = by_topic(path)["log"]
    np.testing.assert_allclose(table.numbers("yaw"), YAW)
    np.testing.assert_allclose(table.numbers("t"), T)


def test_columns_of_another_length_than_the_times_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"log": {"t": T, "yaw": YAW, "n_left": LEFT, "n_right": RIGHT, "x": T[:-3], "y": T[:-3]}})
    guess = guess_map(path)
    assert "# caveat: x, y: 47 values, but 't' has 50; they cannot be imported until" in guess.text
    (tmp_path / "map.toml").write_text(
        'format = "seatrial-import 1"\ntime = { column = "t", format = "s" }\n'
        'signal = [{ name = "x", topic = "log", field = "x", unit = "m" }]\n'
    )
    with pytest.raises(SeatrialError, match=r"'t' of log has 50 values, but x, y have 47; save them with the same"):
        import_files(tmp_path / "map.toml", [path], out=tmp_path / "run.mcap")


def test_variables_with_times_of_their_own_are_imported_without_a_caveat(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    gps = {"t_gps": T[::5], "x": T[::5], "y": -T[::5]}
    savemat(path, {"t": T, "yaw": YAW, "n_left": LEFT, "n_right": RIGHT, **gps})
    assert "same number of values" not in guess_map(path).text


def test_commands_of_a_struct_with_a_field_for_each_side_are_recognised(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    shafts = {"t": T, "rpm_port": 900.0 * LEFT, "rpm_stbd": 900.0 * RIGHT}
    savemat(path, {"imu": {"t": T, "yaw": YAW}, "cmd": {"t": T, "port": LEFT, "stbd": RIGHT}, "esc": shafts})
    text = guess_map(path).text
    assert '\n  { name = "n_cmd_left", topic = "cmd", field = "port", unit = "1"' in text
    assert '\n  { name = "n_right", topic = "esc", field = "rpm_stbd"' in text


def test_a_misspelt_field_of_a_struct_with_several_time_axes_is_named(tmp_path: Path) -> None:
    t = 0.1 * np.arange(50)
    parts = {"gnss": {"time": t[::5], "lat": t[::5]}, "ahrs": {"time": t, "heading": t}}
    savemat(tmp_path / "run.mat", {"log": parts})
    columns = 'topic = "log", field = "ahrs.headng", time = "ahrs.time"'
    (tmp_path / "map.toml").write_text(
        'format = "seatrial-import 1"\ntime = { column = "gnss.time" }\n'
        f'signal = [ {{ name = "psi", {columns}, unit = "rad" }} ]\n'
    )
    with pytest.raises(SeatrialError, match=r"log has no field 'ahrs\.headng'; did you mean 'ahrs\.heading'\?"):
        import_files(tmp_path / "map.toml", [tmp_path / "run.mat"], out_dir=tmp_path)


def nested_run(path: Path, n_gnss: int = 40) -> Path:
    """Write a struct with the parts of a boat, each with its own times; those of gnss may have the length of ahrs."""
    t, t_gnss = 0.1 * np.arange(200), 0.1 * np.arange(n_gnss) + 0.03
    gnss = {"time": t_gnss, "lat": 54.0 + 1e-6 * t_gnss, "lon": 10.0 + 1e-6 * t_gnss, "vn": t_gnss, "ve": -t_gnss}
    ahrs = {"time": t, "hdg": np.mod(350.0 + 20.0 * np.sin(t), 360.0), "yaw_rate": 20.0 * np.cos(t)}
    cmd = {"time": t[::5], "port": np.sin(t[::5]), "stbd": np.cos(t[::5]), "heading": t[::5]}
    savemat(path, {"log": {"gnss": gnss, "ahrs": ahrs, "cmd": cmd, "mag": {"time": t[::2], "x": np.sin(t[::2])}}})
    return path


@pytest.mark.parametrize("n_gnss", [41, 200])  # 200: gnss and ahrs have one table of equal lengths
def test_fields_of_nested_structs_are_recognised_with_the_times_of_their_struct(tmp_path: Path, n_gnss: int) -> None:
    guess = guess_map(nested_run(tmp_path / "run.mat", n_gnss))
    (main,) = (line for line in guess.text.splitlines() if line.startswith("time ="))
    assert 'column = "gnss.time"' in main
    assert '\n  { name = "x", topic = "log", make = "north", fields = ["gnss.lat", "gnss.lon"] }' in guess.text
    assert '\n  { name = "vx", topic = "log", field = "gnss.vn", unit = "m/s" }' in guess.text
    assert '\n  { name = "psi", topic = "log", field = "ahrs.hdg", unit = "deg", time = "ahrs.time"' in guess.text
    assert '\n  { name = "r", topic = "log", field = "ahrs.yaw_rate", unit = "deg/s", time = "ahrs.time"' in guess.text
    assert guess.problem == ""
    assert list(guess.unrecognised) == ["mag.x"]  # no position
    assert '\n  { name = "n", ' not in guess.text  # cmd.heading is a command, and neither a heading nor a thruster


def test_python_warns_of_signals_that_a_guessed_map_leaves_out(tmp_path: Path) -> None:
    with pytest.warns(SeatrialWarning, match=r"not recognised and left out: mag\.x; add"):
        st.import_log(nested_run(tmp_path / "run.mat"), out_dir=tmp_path)


def test_an_error_of_a_map_names_the_signal_and_only_real_choices(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(
        'format = "seatrial-import 1"\ntime = { column = "t" }\n'
        'signal = [{ name = "x", make = "nord", columns = ["lat", "lon"] }]\n'
    )
    with pytest.raises(SeatrialError, match=r"signal\[1\]\.make \(signal 'x'\): must be one of north, east, "):
        import_files(path, [tmp_path / "run.mat"], out_dir=tmp_path)
