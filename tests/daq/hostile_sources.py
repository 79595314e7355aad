"""Foreign sources for the study of hostile files: valid files of every format, and complete attacks.

Each attack writes its files into an empty box and returns the commands that a user would run on them.
"""

from __future__ import annotations

import bz2
import contextlib
import os
import random
import sqlite3
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import can
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from tests.daq.csv_files import MAP, ROWS
from tests.daq.importers.test_can_log import DBC
from tests.daq.importers.test_columnar import RUN, save_73
from tests.daq.importers.test_own_hdf5 import MAKERS
from tests.daq.importers.test_ros import STORE, N, imu

MCAP_MAGIC = b"\x89MCAP0\r\n"
T0_NS = 1_700_000_000 * 10**9
NAMES = ("a\x1b]0;x\x07.csv", "a\nb.csv", "\u202evsc.csv", "-o.csv", "a b%s{}.csv", "[red].csv", "$(touch x).csv")
ENCODINGS = ("rot13", "hex", "base64", "idna", "unicode_escape", "utf-7", "bz2", "zlib", "undefined", "punycode")
PATTERNS = ("%Y %Y", "%Y-%Y-%Y", "%" * 9999, "%j" * 200, "%Q", "\x00", "%d.%m.%Y %H:%M:%S" * 300)
FACTORS = ("1e308", "-1e308", "1e400", "nan", "9" * 5000, "1e-400", "0")


class Step(NamedTuple):
    """Command of an attack, and the paths below the box that it may write."""

    words: tuple[str, ...]
    writes: str = ""


def import_of(name: str) -> tuple[Step, ...]:
    """Return the commands that guess a map of a source and import the source with it."""
    return (
        Step(("import", "--guess", name, "-o", "out/map.toml"), "out/map.toml"),
        Step(("import", "out/map.toml", name, "-o", "out/in.mcap"), "out/in.mcap"),
    )


def reading(name: str) -> tuple[Step, ...]:
    """Return the commands that read a log."""
    return (
        Step(("info", name)),
        Step(("recover", name, "-o", "out/whole.mcap"), "out/whole.mcap"),
        Step(("check", name)),
    )


def write_sources(folder: Path) -> tuple[str, ...]:
    """Write a valid file of each foreign format into a folder, and return the names."""
    messages = [
        can.Message(
            timestamp=1.7e9 + 0.05 * k, arbitration_id=291, is_extended_id=False, data=struct.pack("<Hh", 400 * k, k)
        )
        for k in range(60)
    ]
    names = ["candump.log", "can.asc", "can.blf"]
    for name, kind in zip(names, (can.CanutilsLogWriter, can.ASCWriter, can.BLFWriter), strict=True):
        writer = kind(str(folder / name))
        for message in messages:
            writer(message)
        writer.stop()
    (folder / "n2k.txt").write_text(
        "".join(f"17:33:21.{k:03d} R 09F1127F {k:02X} 9D 3D 00 00 00 00 FD\n" for k in range(200)), encoding="ascii"
    )
    savemat(folder / "five.mat", RUN, do_compression=True)
    save_73(folder / "seven.mat", RUN)
    table = pa.table({"t": np.arange(200.0), "heading": np.arange(200.0), "cmd": np.arange(200.0)})
    pq.write_table(table, folder / "run.parquet")
    (folder / "run.csv").write_text(ROWS * 50, encoding="utf-8")
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, how in (("one.bag", None), ("bz2.bag", Bag1Writer.CompressionFormat.BZ2)):
        bag = Bag1Writer(folder / name)
        if how is not None:
            bag.set_compression(how)
        with bag:
            connection = bag.add_connection("/speed", "std_msgs/msg/Float64", typestore=store)
            for k in range(100):
                data = store.serialize_ros1(store.types["std_msgs/msg/Float64"](0.5 * k), "std_msgs/msg/Float64")
                bag.write(connection, T0_NS + k * 10**8, data)
    return (*names, "n2k.txt", "five.mat", "seven.mat", "run.parquet", "run.csv", "one.bag", "bz2.bag")


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _chunk(content: bytes) -> bytes:
    packed = zstandard.ZstdCompressor(level=1).compress(content)
    head = struct.pack("<QQQI", 0, 9, len(content), 0) + _text("zstd") + struct.pack("<Q", len(packed))
    return _record(6, head + packed)


def private_records(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write millions of private records of an application, with or without a message between them."""
    empty = _record(rng.randrange(0x80, 0x100), bytes(rng.choice((0, 0, 1))))
    if rng.random() < 0.5:
        empty = empty * rng.choice((1, 17, 70_000)) + _record(5, struct.pack("<HIQQ", 1, 0, 1, 1))
    content = empty * (rng.choice((1 << 20, 1 << 26)) // len(empty))
    head = _record(1, _text("") + _text("x"))
    (box / "run.mcap").write_bytes(MCAP_MAGIC + head + _chunk(content) * rng.randint(1, 12))
    return reading("run.mcap")


def long_names(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write names of megabytes for an attachment, a channel or a schema, full of terminal control characters."""
    name = rng.choice(("\x1b", "x", "\u202e", "\n")) * rng.choice((70_000, 30_000_000 // 3))
    kind = rng.randrange(3)
    body = struct.pack("<QQ", 1, 1) + _text(name) + _text("text/plain") + struct.pack("<Q", 1) + b"x" + bytes(4)
    if kind == 1:
        body = struct.pack("<HH", 1, 1) + _text(name) + _text("cdr") + bytes(4)
    elif kind == 2:
        body = struct.pack("<H", 1) + _text(name) + _text("ros2msg") + bytes(4)
    record = _record((9, 4, 3)[kind], body)
    (box / "run.mcap").write_bytes(MCAP_MAGIC + _record(1, _text("") + _text("x")) + record * rng.choice((1, 3)))
    return reading("run.mcap")


def many_channels(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write 65,536 channels, or nodes with thousands of digits."""
    schema = rng.choice(("sensor_msgs/msg/Imu", "seatrial_msgs/msg/EscState"))
    content = _record(3, struct.pack("<H", 1) + _text(schema) + _text("ros2msg") + bytes(4))
    n = rng.choice((1, 65_536))
    for k in range(n):
        topic = f"/c{k}/imu" if n > 1 else f"/esc/{'1' * 5000}/state"
        content += _record(4, struct.pack("<HH", k, 1) + _text(topic) + _text("cdr") + bytes(4))
    for k in range(0, n, 9999):
        content += _record(5, struct.pack("<HIQQ", k, 1, 10**18 + k, 10**18 + k) + bytes(400))
    head = _record(1, _text("") + _text("x"))
    (box / "run.mcap").write_bytes(MCAP_MAGIC + head + _chunk(content))
    return reading("run.mcap")


def _bag1_header(**fields: bytes) -> bytes:
    out = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
    return struct.pack("<I", len(out)) + out


def bag_bomb(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write a ROS 1 bag of some kilobytes whose chunk expands to gigabytes, or declares so."""
    megabytes = rng.choice((1, 500, 2000))
    packer = bz2.BZ2Compressor(9)
    packed = b"".join([*(packer.compress(bytes(10**6)) for _ in range(megabytes)), packer.flush()])
    size = struct.pack("<I", rng.choice((megabytes * 10**6, 2**32 - 1, 0)))
    u32 = struct.Struct("<I").pack
    info = _bag1_header(topic=b"/x", type=b"std_msgs/Float64", md5sum=b"*", message_definition=b"float64 data\n")
    connection = _bag1_header(op=b"\x07", conn=u32(0), topic=b"/x") + info
    chunk = _bag1_header(op=b"\x05", compression=b"bz2", size=size) + u32(len(packed)) + packed
    index = _bag1_header(op=b"\x04", ver=u32(1), conn=u32(0), count=u32(1)) + u32(12) + struct.pack("<IIi", 1, 0, 0)
    begin = b"#ROSBAG V2.0\n"
    at = len(begin) + 4096
    head = _bag1_header(
        op=b"\x03", index_pos=struct.pack("<Q", at + len(chunk) + len(index)), conn_count=u32(1), chunk_count=u32(1)
    )
    pad = 4096 - len(head) - 4
    times = {"start_time": struct.pack("<II", 1, 0), "end_time": struct.pack("<II", 2, 0)}
    about = _bag1_header(op=b"\x06", ver=u32(1), chunk_pos=struct.pack("<Q", at), count=u32(1), **times) + u32(8)
    data = begin + head + u32(pad) + b" " * pad + chunk + index + connection + about + struct.pack("<II", 0, 1)
    (box / "run.bag").write_bytes(data)
    return import_of("run.bag")


def tiny_bag(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write a ROS 1 bag of some hundred bytes with a number that requests gigabytes."""
    u32, q = struct.Struct("<I").pack, struct.Struct("<Q").pack
    big = rng.choice((2**31 - 1, 2**32 - 1, 10**8))
    head = _bag1_header(op=b"\x03", index_pos=q(4109), conn_count=u32(big), chunk_count=u32(rng.choice((1, big))))
    data = b"#ROSBAG V2.0\n" + head + u32(4096 - len(head) - 4) + b" " * (4096 - len(head) - 4)
    data += rng.choice((b"", u32(big), _bag1_header(op=b"\x07", conn=u32(0), topic=b"/x") + u32(big)))
    (box / "run.bag").write_bytes(data)
    return import_of("run.bag")


def _bag2(folder: Path, plugin: StoragePlugin, mode: CompressionMode | None = None) -> Path:
    writer = BagWriter(folder, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=STORE)
        for k in range(N):
            data = STORE.serialize_cdr(imu(k), "sensor_msgs/msg/Imu")
            writer.write(connection, T0_NS + k * 10**8, data)
    return next(path for path in folder.iterdir() if path.name != "metadata.yaml")


def zstd_bag(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write a ROS 2 bag whose compressed database or messages expand to gigabytes."""
    mode = rng.choice((CompressionMode.FILE, CompressionMode.MESSAGE))
    data = _bag2(box / "bag", StoragePlugin.SQLITE3, mode)
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    bomb = b"".join([*(packer.compress(bytes(10**7)) for _ in range(rng.choice((30, 1000)))), packer.flush()])
    if mode is CompressionMode.FILE:
        data.write_bytes(rng.choice((bomb, data.read_bytes()[:300] + bomb)))
    else:
        with contextlib.closing(sqlite3.connect(data)) as base:
            base.execute("UPDATE messages SET data = ?", (bomb,))
            base.commit()
    return import_of("bag")


def database_beside(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write a database with a file beside it that looks like the write-ahead log of SQLite."""
    data = _bag2(box / "bag", StoragePlugin.SQLITE3)
    beside = data.with_name(data.name + rng.choice(("-wal", "-journal", "-shm")))
    kind = rng.randrange(4)
    if kind == 0:
        os.mkfifo(beside)
    elif kind == 1:
        beside.symlink_to(rng.choice(("/dev/zero", "/proc/self/mem", str(box / "outside/trap.py"))))
    elif kind == 2:
        magic = rng.choice((b"\x37\x7f\x06\x82", b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"))
        beside.write_bytes(magic + rng.randbytes(50_000))
    else:
        beside.mkdir()
    if rng.random() < 0.5:
        (data.parent / "metadata.yaml").unlink()
    return import_of(rng.choice(("bag", str(data.relative_to(box)))))


def ulog_bomb(box: Path, rng: random.Random, flight: bytes) -> tuple[Step, ...]:
    """Write a ULog with formats that multiply, arrays that are too long, or endless subscriptions."""
    kinds = (
        [f"a{k}:" + f"a{k + 1}[250] x;" * 9 for k in range(12)] + ["a12:uint64_t timestamp;double[250] x;"],
        ["a0:uint64_t timestamp;float[2000000000] x;"],
        ["a0:uint64_t timestamp;" + "".join(f"float[99] f{k};" for k in range(3000))],
        ["a0:uint64_t timestamp;char[65000] x;"],
        ["a0:uint64_t timestamp;a0 x;"],
    )
    texts = [text.encode() for text in rng.choice(kinds)]
    out = bytearray(flight[:16])
    for text in texts:
        out += struct.pack("<Hc", len(text) & 0xFFFF, b"F") + text[:65_535]
    for k in range(rng.choice((1, 3000))):
        name = b"a0"
        out += struct.pack("<Hc", 3 + len(name), b"A") + struct.pack("<BH", k % 256, k) + name
    for k in range(rng.choice((1, 9000))):
        out += struct.pack("<Hc", 10, b"D") + struct.pack("<HQ", k % 3000, k)
    (box / "run.ulg").write_bytes(bytes(out))
    return import_of("run.ulg")


def pipes(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Put a named pipe, a socket or a device in place of a file: a source, a member, a map, a DBC, a rig."""
    kind = rng.randrange(7)
    for name in ("run.csv", "map.toml", "candump.log", "boat.dbc"):
        (box / name).write_text(ROWS if name == "run.csv" else MAP.format(csv="", time="", signal=""), encoding="utf-8")
    (box / "candump.log").write_text("(1700000000.0) can0 123#0102030405060708\n" * 50, encoding="ascii")
    (box / "boat.dbc").write_text(DBC, encoding="ascii")
    if kind == 0:
        name = rng.choice(("p.ulg", "p.bag", "p.mat", "p.csv", "p.BIN", "p.db3", "p.log"))
        os.mkfifo(box / name)
        return (*import_of(name), Step(("import", "mavlink", name, "-o", "out/in.mcap"), "out/in.mcap"))
    if kind == 1:
        data = _bag2(box / "bag", rng.choice((StoragePlugin.MCAP, StoragePlugin.SQLITE3)))
        victim = rng.choice((data, box / "bag/metadata.yaml"))
        victim.unlink()
        os.mkfifo(victim)
        return import_of("bag")
    if kind == 2:
        (box / "boat.dbc").unlink()
        rng.choice((os.mkfifo, lambda path: os.symlink("/dev/zero", path)))(box / "boat.dbc")
        return (Step(("import", "--guess", "candump.log", "--dbc", "boat.dbc", "-o", "out/map.toml"), "out/map.toml"),)
    if kind == 3:
        text = 'format = "seatrial-import 1"\ntime = { column = "t" }\n[can]\ndbc = "pipe.dbc"\n[[signal]]\n'
        text += 'name = "x"\ntopic = "Engine"\nfield = "Speed"\nunit = "1"\n'
        (box / "map.toml").write_text(text, encoding="ascii")
        os.mkfifo(box / "pipe.dbc")
        return (Step(("import", "map.toml", "candump.log", "-o", "out/in.mcap"), "out/in.mcap"),)
    if kind == 4:
        (box / "map.toml").unlink()
        os.mkfifo(box / "map.toml")
        return (Step(("import", "map.toml", "run.csv", "-o", "out/in.mcap"), "out/in.mcap"),)
    if kind == 5:
        os.mkfifo(box / "rig.toml")
        return (
            Step(("import", "can", "rig.toml", "candump.log", "-o", "out/in.mcap"), "out/in.mcap"),
            Step(("check", "rig.toml")),
        )
    os.mkfifo(box / "run.mcap")
    return reading("run.mcap")


def absurd_values(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write values of a map or a DBC that would take much time or memory, or run code."""
    kind = rng.randrange(5)
    csv, time, signal, dbc = "", "", "", DBC
    if kind == 0:
        csv = f"skip_rows = {rng.choice((9 * 10**18, 2**63 - 1, 10**9))}"
    elif kind == 1:
        csv = f'encoding = "{rng.choice(ENCODINGS)}"'
    elif kind == 2:
        time = f"format = '{rng.choice(PATTERNS)}'"
    elif kind == 3:
        signal = rng.choice(("scale = 1e308\noffset = 1e308", "scale = nan", "delay_s = 1e300", "scale = -1e-320"))
    else:
        dbc = DBC.replace("0.25", rng.choice(FACTORS)).replace("[0|16000]", rng.choice(("[0|1e308]", "[nan|nan]")))
        dbc = dbc.replace("0|16@1+", rng.choice(("0|16@1+", "0|64000@1+", "4294967295|16@1+", "0|0@1+")))
    (box / "run.csv").write_text(ROWS * 9, encoding="utf-8")
    (box / "map.toml").write_text(MAP.format(csv=csv, time=time, signal=signal), encoding="utf-8")
    (box / "boat.dbc").write_text(dbc, encoding="utf-8")
    (box / "candump.log").write_text("(1700000000.0) can0 123#FFFFFFFF\n" * 50, encoding="ascii")
    if kind == 4:
        guess = ("import", "--guess", "candump.log", "--dbc", "boat.dbc", "-o", "out/map.toml")
        return (
            Step(guess, "out/map.toml"),
            Step(("import", "out/map.toml", "candump.log", "-o", "out/in.mcap"), "out/in.mcap"),
        )
    return (Step(("import", "map.toml", "run.csv", "-o", "out/in.mcap"), "out/in.mcap"),)


def planted(box: Path, rng: random.Random, log: bytes) -> tuple[Step, ...]:
    """Put a link, dangling or not, or a pipe under the name of an output."""
    (box / "run.mcap").write_bytes(log)
    (box / "run.csv").write_text(ROWS * 9, encoding="utf-8")
    (box / "map.toml").write_text(MAP.format(csv="", time="", signal=""), encoding="utf-8")
    steps = (
        Step(("recover", "run.mcap", "-o", "out/x.mcap")),
        Step(("recover", "run.mcap", "-o", "out/x.mcap", "--force")),
        Step(("export", "csv", "run.mcap", "--out", "out/x")),
        Step(("export", "parquet", "run.mcap", "--out", "out/x")),
        Step(("export", "matlab", "run.mcap", "--out", "out/x.mat")),
        Step(("check", "run.mcap", "--report", "out/x.html")),
        Step(("import", "map.toml", "run.csv", "-o", "out/x.mcap")),
        Step(("import", "--guess", "run.csv", "-o", "out/x.toml")),
    )
    step = rng.choice(steps)
    name = next(word for word in step.words if word.startswith("out/x"))
    folder = not Path(name).suffix  # the user may keep results in a folder that is a link
    kind = rng.randrange(3 if folder else 4)
    if kind == 0:
        (box / name).symlink_to("../outside/new")
    elif kind == 1:
        (box / name).symlink_to("../outside/trap.py")
    elif kind == 2:
        os.mkfifo(box / name)
    else:
        (box / name).symlink_to("../outside")
    return (step,)


def names(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Put control characters and shell commands into the names of files and signals."""
    name = rng.choice(NAMES)
    (box / name).write_text(rng.choice((ROWS, "", "x", "t,\x1b[2J\n1,2\n")), encoding="utf-8")
    (box / "map.toml").write_text(MAP.format(csv="", time="", signal=""), encoding="utf-8")
    return (
        Step(("import", "--guess", f"./{name}", "-o", "out/map.toml"), "out/map.toml"),
        Step(("import", "map.toml", f"./{name}", "-o", "out/in.mcap"), "out/in.mcap"),
        Step(("info", f"./{name}")),
        Step(("check", f"./{name}")),
    )


def foreign_hdf5(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write a MATLAB file whose data is in other files, or whose group contains itself."""
    (box / "outside/secret").write_bytes(b"secret" * 99)
    with h5py.File(box / "outside/secret.h5", "w") as file:
        file["x"] = np.arange(20.0)
    with h5py.File(box / "run.mat", "w", userblock_size=512) as file:
        file["t"] = np.arange(20.0)
        rng.choice(MAKERS)(file, box / "outside/secret")
    with (box / "run.mat").open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file".ljust(512))
    return import_of("run.mat")


def hdf5_bomb(box: Path, rng: random.Random) -> tuple[Step, ...]:
    """Write a MATLAB or Parquet file of some kilobytes with arrays of gigabytes."""
    n = rng.choice((10**7, 4 * 10**8, 10**12))
    kind = rng.randrange(3)
    if kind == 2:
        rows = min(n, 10**8)
        table = pa.table({"t": pa.array(np.zeros(min(rows, 3 * 10**7)))})
        pq.write_table(table, box / "run.parquet", compression="zstd")
        return import_of("run.parquet")
    with h5py.File(box / "run.mat", "w", userblock_size=512) as file:
        options: dict[str, Any] = {"chunks": (1 << 20,), "compression": "gzip"} if kind else {}
        for name in ("t", "x"):
            file.create_dataset(name, (n,), np.float64, fillvalue=0.5 if kind else 0.0, **options)
    with (box / "run.mat").open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file".ljust(512))
    return import_of("run.mat")


ATTACKS: Sequence[Callable[[Path, random.Random], tuple[Step, ...]]] = (
    private_records,
    long_names,
    many_channels,
    bag_bomb,
    tiny_bag,
    zstd_bag,
    database_beside,
    pipes,
    pipes,
    absurd_values,
    absurd_values,
    names,
    foreign_hdf5,
    hdf5_bomb,
)


def damaged_bag(box: Path, rng: random.Random, wounded: Callable[[bytes, random.Random], bytes]) -> tuple[Step, ...]:
    """Damage a ROS 2 bag, compressed or not."""
    mode = rng.choice((None, CompressionMode.FILE, CompressionMode.MESSAGE))
    plugin = StoragePlugin.SQLITE3 if mode is CompressionMode.FILE else rng.choice(tuple(StoragePlugin))
    if plugin is StoragePlugin.SQLITE3 and mode is CompressionMode.STORAGE:
        mode = None
    data = _bag2(box / "bag", plugin, mode)
    data.write_bytes(wounded(data.read_bytes(), rng))
    if rng.random() < 0.3:
        (box / "bag/metadata.yaml").unlink()
    return import_of("bag")


def damaged_source(
    folder: Path, names_: Sequence[str], box: Path, rng: random.Random, wounded: Callable[[bytes, random.Random], bytes]
) -> tuple[Step, ...]:
    """Damage a file of a foreign format."""
    name = rng.choice(names_)
    (box / name).write_bytes(wounded((folder / name).read_bytes(), rng))
    if name.startswith("can") and rng.random() < 0.5:
        dbc = DBC.encode() if rng.random() < 0.5 else wounded(DBC.encode(), rng)
        (box / "boat.dbc").write_bytes(dbc)
        guess = ("import", "--guess", name, "--dbc", "boat.dbc", "-o", "out/map.toml")
        return (Step(guess, "out/map.toml"), import_of(name)[1])
    return import_of(name)
