"""Study of foreign files and the commands that read them: `python -m tests.daq.hostile_files --n 2500 --seed 1`.

Logs, captures, bags, tables, rigs, missions and models go through info, recover, export, check, replay, import, vehicle
and diagnose. The files are damaged (bits, pieces, lengths), hostile (names that are paths, code, bombs) or huge. Each
command runs as a user would run it, with the limits of `seatrial.daq.bounds` if the command has them.

A command has to succeed, or to fail with one line, in 20 s of processor time and 2 GB of memory. It may write only the
named output. It must not execute anything, print a traceback, or print characters that control the terminal.
`tests.daq.hostile_sources` makes the foreign formats and their attacks. File number K of a seed is always the same:
`--first K --n 1 --keep` makes it again and leaves it in place.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import gc
import importlib
import io
import os
import random
import re
import resource
import shutil
import signal
import sqlite3
import struct
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

from seatrial import command_line
from seatrial.daq import bounds
from seatrial.daq.protocol import nmea, vectornav
from seatrial.daq.samples import Ahrs, Gnss
from tests.daq.csv_files import MAP, ROWS
from tests.daq.hostile_sources import ATTACKS, Step, damaged_bag, damaged_source, planted, ulog_bomb, write_sources
from tests.daq.importers.test_mavlink import dataflash, tlog
from tests.daq.importers.test_ros import STORE, N, fix, imu
from tests.daq.importers.test_ulog import flight
from tests.daq.logs import write_everything
from tests.ident.workflows.test_information import write_model
from tests.missions import boat_log, boat_with

MEMORY, SECONDS = 4 << 30, 20  # bytes of address space; the libraries of a fit reserve a part that they never use
RESIDENT = 2_000_000_000  # bytes
OWN_LIBRARIES = 600_000_000  # bytes of address space of a command that reads a foreign file
LARGE = f"more than {RESIDENT / 1e9:.0f} GB of memory"
SLOW = f"{SECONDS} s of processor time"
FITTING, SHARE = ("vehicle", "diagnose"), 0.2  # share of the logs that go through each of these slow commands
WALL_S = 600.0  # seconds, for a busy machine
REPLAY_S = 1.5  # after this time the command is interrupted
TRAPS = ("executed", "trap.py")  # in the folder `outside` of each file's box
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
RUNNING = ("os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.system", "pickle.find_class")
RUNNING += ("socket.bind", "socket.connect", "subprocess.Popen")
MODULES = ("seatrial.ident.workflows.vehicle", "seatrial.ident.workflows.diagnose", "seatrial.ident.report.page")
NUMBERS = [struct.pack("<Q", n) for n in (0, 1, 2**31 - 1, 2**32 - 1, 2**62, 2**63 - 1, 2**64 - 1)]
NUMBERS += [struct.pack("<d", x) for x in (float("nan"), float("inf"), -1e308, 5e-324, 1e18)]
NAMES = [
    "/raw//etc/passwd",
    "/raw/../../outside/x",
    "/raw/ports/../../outside/x",
    "/health/../../outside/x",
    "/../x/gnss",
    "/signal/../../outside/evil",
    "/signal/=cmd()",
    "/signal/a\nb",
    "/ahrs\x1b]0;x\x07/imu",
    "/esc/1e99/state",
    "/esc/\u0663/state",
    "/esc/99999999999999999999/state",
    "",
    "/",
    "/[bold]x/imu",
    "/" + "a" * 70_000 + "/imu",
    "/CON/imu",
    "/a b/imu",
    "/\u202e/imu",
    "//imu",
    "/ahrs/imu/imu",
    "/event",
    "/raw/ahrs\0",
    "/-rf/imu",
]
TOML = [
    "a = " + "[" * 50_000,
    "a = " + "9" * 20_000,
    "x" + ".x" * 20_000 + " = 1",
    "a = 1e999999\nb = nan\nc = -inf\n",
    'a = "' + "x" * 3_000_000 + '"',
    "\x00\x01\x1b[2J",
    "a = 1\n" * 9,
    "[a]\n" * 9000,
    '"\\u202e" = 1',
    "a = {" * 9000,
    "[[device]]\n" * 9000,
    "a = 9999-99-99\n",
    "# \x1b]0;x\x07\n",
    "x = [" + "1," * 600_000 + "]",
]
RIG = """format = "seatrial-rig 1"
name = "x"
[log]
directory = "../outside"
[[device]]
name = "ahrs"
protocol = "vectornav"
port = "../outside/port"
rate_hz = 50.0
[[device]]
name = "cell"
protocol = "loadcell"
port = "/dev/zero"
rate_hz = 80.0
pattern = "(a+)+$"
[[device]]
name = "can"
protocol = "dbc"
port = "slcan:/dev/null"
dbc = "/dev/zero"
rate_hz = 10.0
"""
DIAGNOSE = ("--max-effects", "1", "--despite-faults")  # the file then passes the checks, which `check` runs too
YAML = [
    "!!python/object/apply:os.system ['touch outside/executed']\n",
    "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "".join(f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(9 * ['*' + chr(97 + k)])}]\n" for k in range(9)),
    "rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths: ['../../../../../etc/passwd']\n",
    "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n  relative_file_paths: [/dev/zero]\n",
    "[" * 20_000,
]


class Command(NamedTuple):
    """Command on one file, and the paths below the box that it may write."""

    words: tuple[str, ...]
    writes: str = ""


class Outcome(NamedTuple):
    """Outcome of one command: its failure (empty for a correct command), and whether its exit status is 0."""

    why: str
    answered: bool
    seconds: float  # seconds of processor time
    memory: int  # bytes
    limited: bool  # whether a limit of `seatrial.daq.bounds` ended the command


@dataclass
class Failure:
    """Violation of the rules by a command."""

    number: int
    kind: str
    words: str
    why: str


@dataclass
class Summary:
    """Summary of all commands."""

    files: int = 0
    runs: Counter[str] = field(default_factory=Counter)
    answers: Counter[str] = field(default_factory=Counter)  # number of commands that ended with exit status 0
    seconds: float = 0.0  # of the slowest command
    memory: int = 0  # bytes of the largest command
    limited: Counter[str] = field(default_factory=Counter)  # kinds of files that only a limit of the command ended
    failures: list[Failure] = field(default_factory=list)


LOG = (
    Command(("info", "{}")),
    Command(("recover", "{}", "-o", "out/whole.mcap"), "out/whole.mcap"),
    Command(("export", "csv", "{}", "--out", "out/tables"), "out/tables"),
    Command(("check", "{}")),
    Command(("replay", "{}", "--dir", "out/ports", "--speed", "1000"), "out/ports"),
)
FITS = (
    Command(("ident", "vehicle", "{}", "--despite-faults", "--out", "out/fitted"), "out/fitted"),
    Command(("ident", "diagnose", "model/model.toml", "{}", *DIAGNOSE, "--out", "out/found"), "out/found"),
)


GUESSED = (
    Command(("import", "--guess", "{}", "-o", "out/map.toml"), "out/map.toml"),
    Command(("import", "out/map.toml", "{}", "-o", "out/in.mcap"), "out/in.mcap"),
)


class Bases:
    """Valid files, made once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        boat_log(folder / "boat.mcap", boat_with(None, 4), 60.0, 3)
        write_everything(folder / "all.mcap", 12)
        (folder / "made").mkdir()
        write_model(folder / "made/model.toml")
        tlog(folder / "run.tlog")
        dataflash(folder / "run.BIN")
        flight(folder / "run.ulg")
        for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
            with BagWriter(folder / f"bag-{plugin.name}", version=9, storage_plugin=plugin) as writer:
                for topic, kind, make in (
                    ("/imu", "sensor_msgs/msg/Imu", imu),
                    ("/fix", "sensor_msgs/msg/NavSatFix", fix),
                ):
                    connection = writer.add_connection(topic, kind, typestore=STORE)
                    for k in range(N):
                        writer.write(connection, (1_700_000_000 + k) * 10**9, STORE.serialize_cdr(make(k), kind))  # type: ignore[arg-type]
        epochs = (nmea.encode(Gnss(1.7e9 + k, 41.0, -8.0, 3.0, 1.0, 0.5, fix=3)) for k in range(200))
        (folder / "gnss.txt").write_bytes(b"".join(epochs))
        attitudes = (vectornav.encode_binary(Ahrs(0.1, 0.2, 0.3), 0.02 * k) for k in range(200))
        (folder / "ahrs.bin").write_bytes(b"".join(attitudes))
        (folder / "run.csv").write_text(ROWS * 50, encoding="utf-8")
        (folder / "map.toml").write_text(MAP.format(csv="", time="", signal=""), encoding="utf-8")
        (folder / "sources").mkdir()
        self.sources = write_sources(folder / "sources")

    def read(self, name: str) -> bytes:
        """Return the bytes of one valid file."""
        return (self.folder / name).read_bytes()


def wounded(data: bytes, rng: random.Random) -> bytes:
    """Damage data in up to eight places: bits and numbers changed, pieces removed, doubled, moved, zeroed or
    randomised.
    """
    out = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        if not out:
            break
        at, length, kind = rng.randrange(len(out)), 1 << rng.randrange(13), rng.randrange(8)
        if kind == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at : at + 8] = rng.choice(NUMBERS)
        elif kind == 2:
            del out[at : at + length]
        elif kind == 3:
            out[at:at] = out[at : at + length]
        elif kind == 4:
            out[at : at + length] = rng.randbytes(length)
        elif kind == 5:
            out[at : at + length] = bytes(length)
        elif kind == 6:
            source = rng.randrange(len(out))
            out[at : at + length] = out[source : source + length]
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def rewritten(data: bytes, rng: random.Random) -> bytes:
    """Return a valid log container with hostile names, types, times, values, attachments or metadata."""
    kind = rng.choice(("topics", "values", "times", "schemas", "attachments", "metadata", "channels", "mixed"))

    def of(name: str, chance: float) -> bool:
        return kind in (name, "mixed") and rng.random() < chance

    buffer, reader = io.BytesIO(), make_reader(io.BytesIO(data))
    writer = Writer(buffer, compression=rng.choice((CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE)))
    writer.start(profile=rng.choice(("ros2", "", "\x1b[2J")))
    for record in reader.iter_metadata():
        hostile = {key: rng.choice(("nan", "-1", "1e999", "", "\x1b[2J[red]", "x" * 99_999)) for key in record.metadata}
        writer.add_metadata(record.name, {**record.metadata, **(hostile if of("metadata", 0.7) else {})})
    for attachment in reader.iter_attachments():
        name, content = attachment.name, attachment.data
        if of("attachments", 0.7):
            name = rng.choice((name, name, "rig.toml", "vehicle.toml", "../../outside/x", "\x1b[2J", "x" * 9999))
            content = rng.choice(
                [*(text.encode(errors="replace") for text in (*TOML, RIG)), wounded(content, rng), bytes(10**8)]
            )
        writer.add_attachment(attachment.create_time, attachment.log_time, name, attachment.media_type, content)
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        if schema.id not in schemas:
            text, name, encoding = schema.data, schema.name, schema.encoding
            if of("schemas", 0.4):
                text = rng.choice(
                    (wounded(text, rng), b"", b"x/X a\n" + b"=" * 80 + b"\nMSG: x/X\nx/X a\n", bytes(10**6))
                )
                name, encoding = rng.choice((name, "a/msg/B", "\x1b[2J", "")), rng.choice((encoding, "protobuf", ""))
            schemas[schema.id] = writer.register_schema(name, encoding, text)
        if channel.id not in channels:
            topic = rng.choice(NAMES) if of("topics", 0.5) else channel.topic
            about = {"unit": "\x1b[2J", "hold": "x", "role": "=1"} if of("channels", 0.5) else channel.metadata
            coding = rng.choice(("cdr", "ros1", "")) if of("channels", 0.3) else channel.message_encoding
            channels[channel.id] = writer.register_channel(topic, coding, schemas[schema.id], about)
            for k in range(rng.choice((0, 0, 3000)) if kind == "channels" else 0):
                writer.register_channel(f"/c{k}/imu", "cdr", schemas[schema.id])
        times = [message.log_time, message.publish_time]
        if of("times", 0.05):
            times = [rng.choice((0, 1, 2**63 - 1, 2**63, 2**64 - 1, t, t + 10**13)) for t in times]
        body = bytearray(message.data)
        if of("values", 0.05):
            at = rng.randrange(4, max(len(body) - 8, 5))
            body[at : at + 8] = rng.choice(NUMBERS)
            body = body[: rng.choice((len(body), len(body), 3, 0))]
        writer.add_message(channels[channel.id], times[0], bytes(body), times[1], message.sequence)
    writer.finish()
    return buffer.getvalue()


def bomb(data: bytes, rng: random.Random) -> bytes:
    """Return a log with a chunk that expands, a wrong length, a record in a record, or a great number of records."""
    magic, kind = data[:8], rng.randrange(6)
    if kind == 0:  # 1 GiB of zeros compressed to 32 KiB, with any declared size
        packed = zstandard.ZstdCompressor(level=1).compress(bytes(1 << 28)) * 4
        size = rng.choice((1 << 20, 1 << 26, 1 << 30, 1 << 62))
        body = (
            struct.pack("<QQQI", 0, 9, size, 0)
            + struct.pack("<I", 4)
            + b"zstd"
            + struct.pack("<Q", len(packed))
            + packed
        )
        return magic + data[8:200] + b"\x06" + struct.pack("<Q", len(body)) + body + data[200:]
    if kind == 1:
        at = rng.randrange(8, len(data))
        return data[:at] + bytes((rng.randrange(1, 16),)) + rng.choice(NUMBERS) + data[at:]
    if kind == 2:
        return magic + b"".join(
            b"\x0c" + struct.pack("<Q", 16) + struct.pack("<II", 0, 0) + bytes(8) for _ in range(200_000)
        )
    if kind == 3:
        return data * rng.choice((2, 30))
    if kind == 4:
        return magic + (b"\x06" + struct.pack("<Q", 2**40)) * 5000
    return magic + rng.randbytes(1 << 20)


def _text(data: bytes, rng: random.Random) -> bytes:
    """Return a TOML file with other words in it."""
    lines = data.decode(errors="replace").splitlines()
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(lines)) if lines else 0
        key = lines[at].partition("=")[0] if lines else "x"
        value = rng.choice(
            (
                "nan",
                "-inf",
                "1e308",
                "0",
                "-1",
                '""',
                '"\x1b[2J"',
                "[]",
                "{}",
                "true",
                "9" * 6000,
                '"../outside/trap.py"',
                '"[red]"',
                "1979-05-27",
                "[[1,2],[3]]",
                "[" * 900,
                '"' + "x" * 99_999 + '"',
            )
        )
        lines[at : at + 1] = [[f"{key}= {value}"], [], [lines[at]] * 2 if lines else [], [rng.choice(TOML)[:9999]]][
            rng.randrange(4)
        ]
    return "\n".join(lines).encode(errors="replace")


class Maker:
    """Maker of file number K of a seed: its kind, the file in its box, and the commands to run on it."""

    def __init__(self, bases: Bases, seed: int) -> None:
        self._bases, self._seed = bases, seed
        self._kinds: list[tuple[int, str, Callable[[Path, random.Random], tuple[Command, ...]]]] = [
            (22, "log, damaged", self._damaged_log),
            (22, "log, hostile", self._hostile_log),
            (6, "log, bomb", self._bomb),
            (4, "log, huge or none", self._no_log),
            (8, "csv", self._csv),
            (8, "mavlink", self._mavlink),
            (7, "ros2", self._ros2),
            (6, "ulog", self._ulog),
            (6, "raw", self._raw),
            (6, "model", self._model),
            (5, "rig or mission", self._rig),
            (16, "foreign, damaged", self._source),
            (22, "foreign, hostile", self._attack),
            (4, "output, planted", self._planted),
        ]

    def make(self, number: int, box: Path) -> tuple[str, tuple[Command, ...]]:
        """Write file `number` into an empty box. Return its kind and commands."""
        rng = random.Random(f"{self._seed}/{number}")
        for name in ("out", "outside", "home"):
            (box / name).mkdir(parents=True)
        (box / "outside/trap.py").write_text("open('outside/executed', 'w').close()\nEFFECTS = ()\n", encoding="ascii")
        shutil.copytree(self._bases.folder / "made", box / "model")
        _, kind, make = rng.choices(self._kinds, [row[0] for row in self._kinds])[0]
        return kind, make(box, rng)

    def _base(self, rng: random.Random) -> bytes:
        return self._bases.read(rng.choice(("boat.mcap", "boat.mcap", "all.mcap")))

    def _log(self, box: Path, data: bytes, rng: random.Random) -> tuple[Command, ...]:
        (box / "run.mcap").write_bytes(data)
        fits = tuple(command for command in FITS if rng.random() < SHARE)
        return _of((*LOG, *fits), "run.mcap")

    def _damaged_log(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        data = self._base(rng)
        if rng.random() < 0.2:
            (box / "run.1.mcap").write_bytes(wounded(data, rng))
        return self._log(box, wounded(data, rng), rng)

    def _hostile_log(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        return self._log(box, rewritten(self._base(rng), rng), rng)

    def _bomb(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        return self._log(box, bomb(self._base(rng), rng), rng)

    def _no_log(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        path, kind = box / "run.mcap", rng.randrange(6)
        if kind == 0:
            os.mkfifo(path)
        elif kind == 1:
            path.symlink_to(rng.choice(("run.mcap", "/dev/zero", "/dev/full", "/proc/self/mem", "outside")))
        elif kind == 2:
            path.mkdir()
        else:
            path.write_bytes(rng.choice((b"", self._bases.read("boat.mcap")[:8], rng.randbytes(5000), RIG.encode())))
            if kind == 3:
                os.truncate(path, 3 << 30)  # zeros in a sparse file, which takes no space on the disk
        return _of((*LOG, *FITS), "run.mcap")

    def _csv(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        rows, map_ = self._bases.read("run.csv"), self._bases.read("map.toml")
        kind = rng.randrange(10)
        if kind == 0:
            map_ = rng.choice((*TOML, RIG)).encode(errors="replace")
        elif kind < 4:
            map_ = _text(map_, rng)
        rows = (
            [
                b"t,cmd,heading\n" + b"9" * 10_000_000,
                b",".join(b"c%d" % k for k in range(200_000)) + b"\n" + b"1," * 200_000,
                b't,cmd,heading\n"' + b"a\n" * 200_000,
                rows.replace(b"0.5", b"\0"),
                rows.decode().encode("utf-16"),
                b"t,cmd,heading\n" + b"1e999,nan,inf\n" * 99,
                b"t,cmd,heading\n" + b"".join(b"%d,1,2\n" % (2**k) for k in range(300)),
                b"t,t,t\n1,2,3\n",
                b"t,cmd,heading\n=1+1,\x1b[2J,\xff\xfe\n",
                wounded(rows, rng),
            ][rng.randrange(10)]
            if kind > 2
            else rows
        )
        (box / "run.csv").write_bytes(rows)
        (box / "map.toml").write_bytes(map_)
        return (Command(("import", "map.toml", "run.csv", "-o", "out/in.mcap"), "out/in.mcap"),)

    def _mavlink(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        name = rng.choice(("run.tlog", "run.BIN"))
        data = wounded(self._bases.read(name), rng)
        if rng.random() < 0.2:
            formats = (b"\xa3\x95\x80" + rng.randbytes(86) for _ in range(200))
            data = rng.choice(
                (b"".join(formats) + data, data * 40, bytes(20_000_000), b"\xfd\xff" * 500_000, data[:30])
            )
        return self._import(box, name, data, "mavlink")

    def _ulog(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        data = wounded(self._bases.read("run.ulg"), rng)
        if rng.random() < 0.3:
            head = self._bases.read("run.ulg")[:16]
            loops = (
                b"a:a x;",
                b"a:b x;",
                b"a:uint64_t timestamp;uint8_t[999999999] x;",
                b"a:" + b"float x;" * 9000,
                b":;",
                b"a:[] x;",
            )
            records = (struct.pack("<Hc", len(r) & 0xFFFF, b"F") + r for r in rng.sample(loops, 3))
            data = head + b"".join(records) + rng.choice((data[16:], b"\xff\xffD" * 99_999, b""))
        (box / "run.ulg").write_bytes(data)
        return _of(GUESSED, "run.ulg")

    def _raw(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        name = rng.choice(("gnss.txt", "ahrs.bin"))
        data = wounded(self._bases.read(name), rng)
        if rng.random() < 0.3:
            data = rng.choice(
                (
                    b"$" * 3_000_000,
                    b"\xfa" * 3_000_000,
                    b"$GPGGA," + b"9" * 5_000_000,
                    rng.randbytes(3_000_000),
                    b"\xb5\x62\x01\x07\xff\xff" * 200_000,
                    b"\x75\x65\x80\xff" * 300_000,
                    b"1\n" * 500_000,
                )
            )
        protocol = rng.choice(("nmea", "ubx", "vectornav", "mip", "loadcell", "openscale", "mantracourt"))
        return self._import(box, name, data, "raw", protocol)

    def _import(self, box: Path, name: str, data: bytes, *words: str) -> tuple[Command, ...]:
        (box / name).write_bytes(data)
        rate = ("--rate", "40") if words[0] == "raw" and len(data) % 2 else ()
        return (Command(("import", *words, name, *rate, "-o", "out/in.mcap"), "out/in.mcap"),)

    def _ros2(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        source = self._bases.folder / rng.choice(("bag-MCAP", "bag-SQLITE3"))
        shutil.copytree(source, box / "bag")
        data = next(path for path in (box / "bag").iterdir() if path.name != "metadata.yaml")
        kind = rng.randrange(5)
        if kind == 0:
            (box / "bag/metadata.yaml").write_text(rng.choice(YAML), encoding="ascii")
        elif kind == 1:
            (box / "bag/metadata.yaml").write_bytes(wounded((box / "bag/metadata.yaml").read_bytes(), rng))
        elif kind == 2 and data.suffix == ".db3":
            with contextlib.closing(sqlite3.connect(data)) as base:
                base.execute("ALTER TABLE messages RENAME TO other")
                base.execute(
                    "CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) "
                    "SELECT x AS id, 1 AS topic_id, x AS timestamp, zeroblob(99) AS data FROM c"
                )
                base.commit()
        else:
            data.write_bytes(wounded(data.read_bytes(), rng))
        return _of(GUESSED, "bag")

    def _model(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        (box / "run.mcap").write_bytes(self._bases.read("boat.mcap"))
        text = (box / "model/model.toml").read_bytes()
        if rng.random() < 0.4:
            trap = rng.choice(("../outside/trap.py", "trap.py", str(box / "outside/trap.py"), "/dev/zero", "os"))
            if trap == "trap.py":  # beside the model, but not the file with which the model was made
                shutil.copy(box / "outside/trap.py", box / "model")
            text = re.sub(rb"(?m)^source = .*", f'source = "{trap}:EFFECTS"'.encode(), text)
            text = re.sub(rb"(?m)^effects = .*", f'effects = ["{trap}:EFFECTS"]\nsha256 = "0"'.encode(), text)
        else:
            toml = rng.choice(TOML).encode(errors="replace")
            text = rng.choice((_text(text, rng), _text(text, rng), wounded(text, rng), toml))
        (box / "model/model.toml").write_bytes(text)
        export = Command(("ident", "export", "model/model.toml", "--to", "python", "-o", "out/m.py"), "out/m.py")
        return (*_of(FITS[-1:], "run.mcap"), export)

    def _source(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        if rng.random() < 0.2:
            return _commands(damaged_bag(box, rng, wounded))
        return _commands(damaged_source(self._bases.folder / "sources", self._bases.sources, box, rng, wounded))

    def _attack(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        if rng.random() < 0.08:
            return _commands(ulog_bomb(box, rng, self._bases.read("run.ulg")))
        return _commands(rng.choice(ATTACKS)(box, rng))

    def _planted(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        return _commands(planted(box, rng, self._bases.read("boat.mcap")))

    def _rig(self, box: Path, rng: random.Random) -> tuple[Command, ...]:
        texts = [text.encode(errors="replace") for text in (*TOML, RIG, RIG)]
        for name in ("rig.toml", "mission.toml"):
            (box / name).write_bytes(_text(RIG.encode(), rng) if rng.random() < 0.5 else rng.choice(texts))
        return (
            Command(("check", "rig.toml", "--seconds", "0.5", "--mission", "mission.toml")),
            Command(("mission", "show", "mission.toml")),
        )


def _commands(steps: Sequence[Step]) -> tuple[Command, ...]:
    return tuple(Command(*step) for step in steps)


def _of(commands: Sequence[Command], name: str) -> tuple[Command, ...]:
    return tuple(Command(tuple(word.format(name) for word in c.words), c.writes) for c in commands)


def _main(words: Sequence[str]) -> int:
    try:
        command_line.main(words)
    except SystemExit as error:
        return error.code if isinstance(error.code, int) else 1
    return 0


def _child(command: Command, box: Path, cache: Path) -> None:
    """Replace this process by the command. The function never returns."""
    status = 99
    try:
        os.chdir(box)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(box.with_suffix(f".{name}"), WRITING & ~os.O_RDWR, 0o600), number)
        faulthandler.disable()
        sys.stdout, sys.stderr = (os.fdopen(number, "w", 1, "utf-8", closefd=False) for number in (1, 2))
        report = os.open(box.with_suffix(".audit"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        sys.dont_write_bytecode = True  # Python then writes no bytecode, which would count as a file
        os.environ |= {"HOME": str(box / "home"), "SEATRIAL_CACHE": str(cache), "TMPDIR": str(box / "home")}
        tempfile.tempdir = None
        sys.argv = ["seatrial", *command.words]
        # This process has loaded the libraries of all commands, or of all tests. The memory of the command itself
        # counts, with a usual size of libraries.
        loaded = resource.getpagesize() * int(Path("/proc/self/statm").read_bytes().split()[0])
        beyond = max(loaded - OWN_LIBRARIES, 0)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY + beyond, MEMORY + beyond))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        allowed = (f"{box}/", f"{cache}/", "/dev/null", "/dev/pts/", "/dev/tty", "/dev/ptmx")

        def watch(event: str, args: tuple[Any, ...]) -> None:
            text = ""
            if event == "open" and isinstance(args[0], str) and isinstance(args[2], int) and args[2] & WRITING:
                text = "" if os.path.realpath(args[0]).startswith(allowed) else f"wrote {args[0]}"
            elif event == "os.fork" and sys._getframe(1).f_code.co_filename == bounds.__file__:
                text = ""
            elif event.startswith(RUNNING):
                text = f"{event} {args!r}"[:200]
            elif event == "exec" and not (name := getattr(args[0], "co_filename", "<")).startswith("<"):
                text = f"executed {name}" if os.path.realpath(name).startswith(str(box)) else ""
            if text:
                os.write(report, text.encode(errors="replace") + b"\n")

        sys.addaudithook(watch)
        bounds.MEMORY_BYTES += beyond
        bounds.enable()
        status = _main(command.words)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)


def _tree(box: Path) -> dict[str, tuple[int, int]]:
    found = {}
    for folder, _, names in os.walk(box):
        for name in names:
            path = Path(folder, name)
            there = path.lstat()
            found[str(path.relative_to(box))] = (there.st_size, there.st_mtime_ns)
    return found


def run(command: Command, box: Path, cache: Path) -> Outcome:
    """Run a command on the file in its box."""
    before = _tree(box)
    child = os.fork()
    if child == 0:
        _child(command, box, cache)
    start, ports, asked = time.monotonic(), {}, False
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            break
        age = time.monotonic() - start
        for path in (box / "out/ports").glob("*") if command.words[0] == "replay" else ():
            if path.name not in ports and path.is_symlink():
                with contextlib.suppress(OSError):
                    ports[path.name] = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)
        for port in ports.values():
            with contextlib.suppress(OSError):
                os.read(port, 1 << 16)
        if command.words[0] == "replay" and age > REPLAY_S and not asked:
            os.kill(child, signal.SIGINT)
            asked = True
        if age > WALL_S:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.005)
    for port in ports.values():
        os.close(port)
    output, errors, audit = (box.with_suffix(f".{name}").read_bytes() for name in ("stdout", "stderr", "audit"))
    why = _why(status, output.decode(errors="replace"), errors.decode(errors="replace"), audit.decode())
    written = [name for name, what in _tree(box).items() if before.get(name) != what]
    touched = (*written, *before.keys() - _tree(box).keys())
    stray = [name for name in touched if not command.writes or not name.startswith(command.writes)]
    if not why and stray:
        why = f"wrote or removed {', '.join(stray[:3])}"
    memory = usage.ru_maxrss * 1024
    if not why and memory > RESIDENT:
        why = LARGE
    limited = bounds.ADVICE in errors.decode(errors="replace")
    return Outcome(why, status == 0, usage.ru_utime + usage.ru_stime, memory, limited)


def _why(status: int, output: str, errors: str, audit: str) -> str:
    last = (errors.strip().splitlines() or [""])[-1][:200]
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return SLOW if number == signal.SIGXCPU else f"signal {number}: {last}"
    if "Traceback" in errors or "internal error" in errors:
        return f"traceback: {last}"
    if audit:
        return audit.splitlines()[0]
    if bad := re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]", output + errors):
        return f"prints {bad[0]!r}"
    code = os.WEXITSTATUS(status)
    if code not in (0, 1, 2):
        return f"status {code}: {last}"
    if code and not output and not last.startswith("seatrial"):
        return f"no line of an error: {last}"
    return ""


def study(
    n: int,
    seed: int,
    first: int,
    folder: Path,
    *,
    keep: bool = False,
    fits: bool = True,
    stopped: Callable[[], bool] = bool,
) -> Summary:
    """Make files `first` to `first + n` of a seed and run their commands. Print failures as they occur."""
    for name in ("seatrial.daq.tools", "seatrial.ident.checks.log_checks", *(MODULES if fits else ())):
        importlib.import_module(name)
    (folder / "bases").mkdir(parents=True)
    (folder / "cache").mkdir(mode=0o700)
    os.environ["SEATRIAL_CACHE"] = str(folder / "cache")
    maker, summary = Maker(Bases(folder / "bases"), seed), Summary()
    gc.freeze()  # so that the child processes share these pages
    for number in range(first, first + n):
        if stopped():
            break
        box = folder / f"{number}"
        kind, commands = maker.make(number, box)
        summary.files += 1
        for command in commands:
            if command.words[1] in FITTING and not fits:
                continue
            found = run(command, box, folder / "cache")
            # compiled code is made only once, and a machine that stood still also counts as slow here
            if found.why == SLOW:
                found = run(command, box, folder / "cache")
            name = command.words[command.words[0] == "ident"]
            summary.runs[name] += 1
            summary.answers[name] += found.answered
            summary.limited[kind] += found.limited
            if found.limited:
                words = " ".join(command.words)
                print(f"{number} {kind}: {words}: ended by a limit after {found.seconds:.1f} s", flush=True)
            summary.seconds = max(summary.seconds, found.seconds)
            summary.memory = max(summary.memory, found.memory)
            if found.why:
                summary.failures.append(Failure(number, kind, " ".join(command.words), found.why))
                print(f"{number} {kind}: {' '.join(command.words)}: {found.why}", flush=True)
        if not keep:
            shutil.rmtree(box)
    return summary


def _lines(summary: Summary) -> Iterator[str]:
    runs = ", ".join(f"{name} {summary.answers[name]} of {count}" for name, count in summary.runs.items())
    yield f"{summary.files} files, {summary.runs.total()} runs; with an answer: {runs}"
    limited = ", ".join(f"{kind} {count}" for kind, count in summary.limited.items() if count)
    yield f"ended by a limit of the command: {limited or 'none'}"
    yield f"{len(summary.failures)} failures; at most {summary.seconds:.1f} s and {summary.memory / 1e9:.2f} GB"


def main() -> int:
    """Run the study. The exit status is 1 if a command broke a promise of the page on threats."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--n", type=int, default=2500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--keep", action="store_true", help="leave the files in build/hostile")
    parser.add_argument("--no-fits", action="store_true", help="leave out what takes most of the time")
    args = parser.parse_args()
    folder = Path("build/hostile").absolute() if args.keep else Path(tempfile.mkdtemp(prefix="hostile-"))
    shutil.rmtree(folder, ignore_errors=True)
    asked = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: asked.set())
    try:
        summary = study(
            args.n, args.seed, args.first, folder, keep=args.keep, fits=not args.no_fits, stopped=asked.is_set
        )
    finally:
        if not args.keep:
            shutil.rmtree(folder, ignore_errors=True)
    print(*_lines(summary), sep="\n")
    return 1 if summary.failures else 0


if __name__ == "__main__":
    sys.exit(main())
