"""Bounds for commands that read files of others: a child process with limits of memory, processor time and disk.

A file of some kilobytes can ask for gigabytes, for minutes, or for an endless search: by a length that is not true, by
data that is compressed thousands of times, or by a fault in a library that reads it. The command therefore continues in
a child process (`continue_in_child`). The parent process only waits, passes signals on, watches the disk, and removes
what a killed child has left. The limits grow with the size of the files, so a large log is read as it always was. The
child has the terminal of its parent: progress and error lines are those of a command without a child.

Limits of a process are those of setrlimit(2). The disk is also watched from outside, because RLIMIT_FSIZE holds for
each file alone.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import glob
import os
import resource
import select
import shutil
import signal
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, NoReturn

import click

from seatrial.daq.errors import SeatrialError, printable
from seatrial.daq.files import report_scratch_to, require_file

# What a command may take without a file, and in addition for each byte of the files.
# A table of 110 MB took 12 bytes of memory and 0.6 us of processor time for each of its bytes.
# The import of one of 21 MB took 10 to 11 s with the limits and without them.
MEMORY_BYTES, MEMORY_RATIO = 1_900_000_000, 64
CPU_S, CPU_S_PER_BYTE = 15.0, 20e-6
DISK_BYTES, DISK_RATIO = 256 << 20, 64
GRACE_S = 2  # of processor time between the signal that ends a command in good order and the one that kills it
WATCH_S = 0.1  # wall, between two looks at the disk
REPEAT_S = 1.0  # wall; a second Ctrl-C within this is the same one, which came by the parent
MAX_FILES = 10_000  # of a folder, that are looked at
ADVICE = "it is damaged, or made to do harm; --trust-file reads it without limits"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Bounds(NamedTuple):
    """Limits of one command, and the file that is named where one is reached."""

    path: Path
    memory: int  # bytes of address space
    cpu_s: int
    disk: int  # bytes of all that it writes to the temporary folder, and of each file elsewhere


_enabled = False  # whether this process is the command itself, and no test or program that calls it
_bounds: Bounds | None = None  # those of this process, where it is the child


def enable() -> None:
    """Let commands of this process continue in a child. A program that only calls their functions stays as it is."""
    global _enabled
    _enabled = True


def require_files(path: Path) -> None:
    """Raise SeatrialError where a path, or anything in the folder that it is, is no regular file."""
    for file in _files(path):
        require_file(file)


def _files(path: Path) -> Iterator[Path]:
    """The file itself, or what is in a folder and its folders, links to folders not followed."""
    if not path.is_dir():
        yield path
        return
    n = 0
    for folder, _, names in os.walk(path):
        for name in names:
            n += 1
            if n > MAX_FILES:
                raise SeatrialError(f"{path}: is a folder of more than {MAX_FILES} files; name the file to read")
            yield Path(folder, name)


def bounded(
    *names: str, when: Callable[[dict[str, Any]], bool] = lambda _: True
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a click command that reads foreign files: it runs in a bounded child, but for `--trust-file`.

    Parameters
    ----------
    names
        The parameters of the command that are files to read: paths, tuples of paths, or None.
    when
        Whether the command is one that reads foreign files, by its parameters.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def run(*args: Any, trust_file: bool, **options: Any) -> Any:
            if _enabled and not trust_file and when(options):
                given = (options[name] for name in names)
                paths = [path for one in given for path in (one if isinstance(one, tuple) else (one,)) if path]
                continue_in_child(paths)
            return command(*args, **options)

        text = "Read the files without limits of memory, processor time and disk."
        return click.option("--trust-file", is_flag=True, help=text)(run)

    return decorate


def continue_in_child(paths: Sequence[Path]) -> None:
    """Return in a new child process that has the limits of these files.

    In the parent this never returns: it waits for the child and leaves with the child's exit status. Raises
    SeatrialError there where the child was ended by a limit or crashed.
    """
    for path in paths:
        require_files(path)
    sizes = [sum(file.stat().st_size for file in (*_files(path), *_segments(path))) for path in paths]
    size, largest = sum(sizes), paths[sizes.index(max(sizes))]
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    memory = max(MEMORY_BYTES, min(MEMORY_BYTES + MEMORY_RATIO * size, whole))
    bounds = Bounds(largest, memory, round(CPU_S + CPU_S_PER_BYTE * size), DISK_BYTES + DISK_RATIO * size)
    sys.stdout.flush()
    sys.stderr.flush()
    scratch = tempfile.mkdtemp(prefix="seatrial-")
    told, reports = os.pipe()
    child, early = 0, list[int]()

    def forward(number: int, frame: FrameType | None) -> None:
        early.append(number)
        if child:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, number)

    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, handler in before.items():
        if handler != signal.SIG_IGN:
            signal.signal(number, forward)
    child = os.fork()
    if child == 0:
        os.close(told)
        for number, handler in before.items():
            signal.signal(number, handler)
        _become_child(bounds, scratch, reports)
        for missed in early:  # signals that came before there was a child to send them to
            os.kill(os.getpid(), missed)
        return
    os.close(reports)
    try:
        _wait(child, told, bounds, Path(scratch))
    finally:
        os.close(told)
        shutil.rmtree(scratch, ignore_errors=True)


def _segments(path: Path) -> Iterator[Path]:
    """The later segments of a log, and the logs of a database, which are read with it."""
    if path.suffix == ".db3":
        yield from (one for end in ("-wal", "-journal") if (one := Path(f"{path}{end}")).is_file())
    if path.suffix == ".mcap":
        yield from path.parent.glob(f"{glob.escape(path.stem)}.*{path.suffix}")


def _become_child(bounds: Bounds, scratch: str, reports: int) -> None:
    global _bounds
    _bounds = bounds
    report_scratch_to(reports)
    with contextlib.suppress(ImportError, OSError, AttributeError):  # Linux: end with the parent, however that ends
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)  # PR_SET_PDEATHSIG
    os.environ["TMPDIR"] = tempfile.tempdir = scratch
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt_once())
    signal.signal(signal.SIGXCPU, _too_slow)
    for kind, limit in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_AS, bounds.memory),
        (resource.RLIMIT_FSIZE, bounds.disk),
        (resource.RLIMIT_CPU, bounds.cpu_s),
    ):
        hard = resource.getrlimit(kind)[1]
        top = limit + GRACE_S * (kind == resource.RLIMIT_CPU)
        top = top if hard == resource.RLIM_INFINITY else min(top, hard)
        resource.setrlimit(kind, (min(limit, top), top))


def _interrupt_once() -> Callable[[int, FrameType | None], None]:
    """A Ctrl-C reaches the child from the terminal and from its parent; a second must not interrupt the cleaning up."""
    last = -REPEAT_S

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= REPEAT_S:
            last = now
            signal.default_int_handler(number, frame)

    return interrupt


def _too_slow(number: int, frame: FrameType | None) -> NoReturn:
    assert _bounds is not None
    signal.signal(number, signal.SIG_IGN)  # what it says is said once; the hard limit follows
    raise SeatrialError(_of_time(_bounds))


def _of_time(bounds: Bounds) -> str:
    return f"{bounds.path}: reading it took more than {bounds.cpu_s} s of processor time: {ADVICE}"


def _of_disk(bounds: Bounds) -> str:
    return f"{bounds.path}: reading it wrote more than {bounds.disk / 1e6:.0f} MB to the disk: {ADVICE}"


def exceeded(error: BaseException) -> str:
    """Return the line for an error that a limit of this process has caused; "" where there is no such limit."""
    if _bounds is None:
        return ""
    cause: BaseException | None = error
    while cause is not None:  # a reader may have said in its own words what the limit has caused
        if isinstance(cause, MemoryError):
            return f"{_bounds.path}: reading it took more than {_bounds.memory / 1e9:.1f} GB of memory: {ADVICE}"
        if isinstance(cause, OSError) and cause.errno == errno.EFBIG:
            return _of_disk(_bounds)
        cause = cause.__cause__
    return ""


def _wait(child: int, told: int, bounds: Bounds, scratch: Path) -> NoReturn:
    """Wait for the child and leave with its status. Raises SeatrialError where it was killed."""
    made, full = b"", False
    poll = select.poll()
    poll.register(told, select.POLLIN)
    while True:
        if poll.poll(1000 * WATCH_S):
            block = os.read(told, 1 << 16)
            if not block:  # the child has ended
                break
            made += block
        elif _used(scratch) > bounds.disk:
            full = True
            os.kill(child, signal.SIGKILL)
            break
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status >= 0:
        raise click.exceptions.Exit(status)
    for left in filter(None, made.split(b"\0")):
        with contextlib.suppress(OSError):
            if stat.S_ISREG(os.lstat(left).st_mode):
                os.unlink(left)
    number = -status
    if full:
        raise SeatrialError(_of_disk(bounds))
    if number in SIGNALS:  # somebody has ended the command: this process ends likewise
        shutil.rmtree(scratch, ignore_errors=True)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    if number in (signal.SIGXCPU, signal.SIGKILL) and used.ru_utime + used.ru_stime >= bounds.cpu_s:
        raise SeatrialError(_of_time(bounds))
    name = signal.Signals(number).name if number in signal.valid_signals() else f"signal {number}"
    raise SeatrialError(f"{printable(str(bounds.path))}: the reader of the file was ended by {name}: {ADVICE}")


def _used(folder: Path) -> int:
    """Bytes on the disk of all that is in a folder."""
    used = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):  # it is gone by now
                used += 512 * os.lstat(os.path.join(place, name)).st_blocks
    return used
