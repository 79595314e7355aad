"""Resource limits for commands that read files from strangers: a child process with limited memory, time and disk.

A file of some kilobytes can cause a reader to use gigabytes of memory or minutes of time. Possible causes are a false
length in the file, data with an extreme compression ratio, and faults in the libraries that read the file. Therefore
the command continues in a child process (`continue_in_child`). The parent process waits, forwards signals, monitors
the disk, and deletes the scratch files of a killed child. The limits grow with the size of the files, so that large
logs can be read. The child uses the terminal of its parent: the user sees the same output as without a child.

The limits of the process are set by setrlimit(2). The parent also monitors the disk, because RLIMIT_FSIZE limits only
the size of each single file.
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

# Limits of a command without files, and additional amounts for each byte of the files.
# Measured: a table of 110 MB needed 12 bytes of memory and 0.6 us of processor time for each of its bytes.
# The import of a table of 21 MB took 10 to 11 s both with and without the limits.
MEMORY_BYTES, MEMORY_RATIO = 1_900_000_000, 64
CPU_S, CPU_S_PER_BYTE = 15.0, 20e-6
ENDLESS_S = 2**31  # s of processor time, 68 years: no limit
DISK_BYTES, DISK_RATIO = 256 << 20, 64
GRACE_S = 2  # s of processor time between the signal that ends a command with a message and the signal that kills it
WATCH_S = 0.1  # s of wall time between two checks of the disk
REPEAT_S = 1.0  # s of wall time; a second SIGINT within this time is the same Ctrl-C, forwarded by the parent
MAX_FILES = 10_000  # largest number of files in a folder
ADVICE = "the file is damaged or malicious; if you trust it, --trust-file reads it without limits"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Bounds(NamedTuple):
    """Resource limits of one command.

    Attributes
    ----------
    path
        File or folder that the error messages name: the largest of those that the command reads.
    memory
        Limit of the address space [bytes].
    cpu_s
        Limit of the processor time [s].
    disk
        Limit [bytes] of all files in the temporary folder together, and of each single file elsewhere.
    """

    path: Path
    memory: int
    cpu_s: int
    disk: int


_enabled = False  # whether this process is the command itself, not a test or a program that calls its functions
_bounds: Bounds | None = None  # limits of this process; None if this process is not a child


def enable() -> None:
    """Turn the resource limits on: from now on, commands decorated with `bounded` continue in a limited child process.

    Only the command-line program calls this. Programs that call the functions of the commands are not limited.
    """
    global _enabled
    _enabled = True


def require_files(path: Path) -> None:
    """Check that a path is a regular file, or a folder that contains regular files only.

    Raises
    ------
    SeatrialError
        If a file is not regular or cannot be opened, or if the folder with its subfolders contains more than 10,000
        files (MAX_FILES).
    """
    for file in _walk_files(path):
        require_file(file)


def _walk_files(path: Path) -> Iterator[Path]:
    """Yield all files in the folder `path` and its subfolders, or `path` itself if it is not a folder.

    A path that does not exist is yielded too. Below `path`, links to folders are neither followed nor yielded. A folder
    with more than 10,000 files (MAX_FILES) raises SeatrialError.
    """
    if not path.is_dir():
        yield path
        return
    n_files = 0
    for folder, _, names in os.walk(path):
        for name in names:
            n_files += 1
            if n_files > MAX_FILES:
                raise SeatrialError(
                    f"{path}: is a folder of more than {MAX_FILES} files; give the path of the file to read"
                )
            yield Path(folder, name)


def bounded(
    *names: str, when: Callable[[dict[str, Any]], bool] = lambda _: True, serves: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator for a command of the command line that reads files from strangers.

    The command then runs in a child process with limited memory, time and disk, if `enable` was called before. The
    decorator adds the option `--trust-file`, which turns the limits off.

    Parameters
    ----------
    names
        Names of the parameters of the command that are files or folders to read: paths, tuples of paths, or None for no
        file. At least one of them must be a path.
    when
        Function that returns whether the limits apply, from a dictionary of the parameters of the command by name. By
        default they always apply.
    serves
        Whether the command runs until Ctrl-C. Its processor time is then not limited.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        """Return the command with the option `--trust-file`. Without this option it runs in a limited child process.

        The command runs without limits also if `enable` was not called or `when` returns false.
        """

        @functools.wraps(command)
        def run(*args: Any, trust_file: bool, **options: Any) -> Any:
            """Run the command and return its result, in a child process with limited memory, time and disk.

            No limit applies if `trust_file` is true, if `enable` was not called, or if `when(options)` is false. `args`
            and `options` are the parameters of the command.
            """
            if _enabled and not trust_file and when(options):
                values = (options[name] for name in names)
                paths = [path for value in values for path in (value if isinstance(value, tuple) else (value,)) if path]
                continue_in_child(paths, serves)
            return command(*args, **options)

        text = "Read the files without limits of memory, processor time and disk."
        return click.option("--trust-file", is_flag=True, help=text)(run)

    return decorate


def continue_in_child(paths: Sequence[Path], serves: bool = False) -> None:
    """Continue the program in a new child process with limits for these files.

    This function returns in the child only. The parent waits for the child and passes signals on to it. The parent then
    ends with the exit status of the child, or by the same signal if SIGINT, SIGTERM or SIGHUP ended the child.

    Parameters
    ----------
    paths
        Files and folders that the command reads, at least one. The limits grow with their total size, later segments of
        a log and journals of a database included: 1.9 GB of memory plus 64 times the size, at most the memory of the
        computer if it has more than 1.9 GB; 15 s of processor time plus 20 us for each byte; 268 MB of disk plus 64
        times the size.
    serves
        Whether the processor time is not limited, because the command runs until Ctrl-C.

    Raises
    ------
    SeatrialError
        If a path is neither a regular file nor a folder of such files (`require_files`). In the parent also if a limit
        killed the child, or if the child crashed.
    click.exceptions.Exit
        In the parent, with the exit status of the child.
    """
    for path in paths:
        require_files(path)
    sizes = [sum(file.stat().st_size for file in (*_walk_files(path), *_companion_files(path))) for path in paths]
    size, largest = sum(sizes), paths[sizes.index(max(sizes))]
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    memory = max(MEMORY_BYTES, min(MEMORY_BYTES + MEMORY_RATIO * size, whole))
    cpu_s = ENDLESS_S if serves else round(CPU_S + CPU_S_PER_BYTE * size)
    bounds = Bounds(largest, memory, cpu_s, DISK_BYTES + DISK_RATIO * size)
    sys.stdout.flush()
    sys.stderr.flush()
    scratch = tempfile.mkdtemp(prefix="seatrial-")
    incoming, reports = os.pipe()  # names of scratch files, from the child to the parent
    child, early = 0, list[int]()  # `early`: signals before the child existed

    def forward(number: int, frame: FrameType | None) -> None:
        """Handle a signal of the parent: note its number, and send it to the child if the child exists already.

        The new child sends itself the signals that were noted before it existed. If the child has ended, the signal
        is lost, and no error is raised.
        """
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
        os.close(incoming)
        for number, handler in before.items():
            signal.signal(number, handler)
        _become_child(bounds, scratch, reports)
        for missed in early:  # signals that arrived before the child existed
            os.kill(os.getpid(), missed)
        return
    os.close(reports)
    try:
        _wait_for_child(child, incoming, bounds, Path(scratch))
    finally:
        os.close(incoming)
        shutil.rmtree(scratch, ignore_errors=True)


def _companion_files(path: Path) -> Iterator[Path]:
    """Yield the files that are read together with a file: later segments of a log, or journals of a database.

    For STEM.mcap they are all files STEM.*.mcap in the same folder. For FILE.db3 they are FILE.db3-wal and
    FILE.db3-journal, if these exist. A path with another suffix gives nothing. `path` itself is not yielded.
    """
    if path.suffix == ".db3":
        yield from (journal for end in ("-wal", "-journal") if (journal := Path(f"{path}{end}")).is_file())
    if path.suffix == ".mcap":
        yield from path.parent.glob(f"{glob.escape(path.stem)}.*{path.suffix}")


def _become_child(bounds: Bounds, scratch: str, reports: int) -> None:
    """Make this process the limited child: set its resource limits, signal handlers and temporary folder.

    At the limit of processor time a SeatrialError is raised in the child, and the child is killed after 2 s more
    (GRACE_S). On Linux the child is also killed when its parent ends for any reason. The child writes no core dump.

    Parameters
    ----------
    bounds
        Limits of the child. A hard limit of the system that is lower stays.
    scratch
        The temporary folder.
    reports
        File descriptor of the pipe to which the names of scratch files are written.
    """
    global _bounds
    _bounds = bounds
    report_scratch_to(reports)
    with contextlib.suppress(ImportError, OSError, AttributeError):  # on Linux: end when the parent ends for any reason
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)  # PR_SET_PDEATHSIG
    os.environ["TMPDIR"] = tempfile.tempdir = scratch
    if signal.getsignal(signal.SIGINT) == signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt_once())
    signal.signal(signal.SIGXCPU, _raise_time_limit)
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
    """Return a handler of SIGINT for the child process that ignores a second signal which follows at once.

    The first signal raises KeyboardInterrupt; others within 1 s (REPEAT_S) are ignored. A Ctrl-C reaches the child
    twice, from the terminal and from its parent. The second signal must not interrupt the clean-up.
    """
    last = -REPEAT_S

    def interrupt(number: int, frame: FrameType | None) -> None:
        """Handle SIGINT: raise KeyboardInterrupt, unless the last one was raised less than 1 s ago (REPEAT_S)."""
        nonlocal last
        now = time.monotonic()
        if now - last >= REPEAT_S:
            last = now
            signal.default_int_handler(number, frame)

    return interrupt


def _raise_time_limit(number: int, frame: FrameType | None) -> NoReturn:
    """Handle the signal SIGXCPU: raise SeatrialError with the message that the limit of processor time was reached.

    Later signals SIGXCPU are ignored.
    """
    assert _bounds is not None
    signal.signal(number, signal.SIG_IGN)  # raise this error only once; the hard limit kills the process later
    raise SeatrialError(_time_message(_bounds))


def _time_message(bounds: Bounds) -> str:
    """Return the error message that reading a file has reached the limit of processor time, with advice."""
    return f"{bounds.path}: reading it took more than {bounds.cpu_s} s of processor time: {ADVICE}"


def _disk_message(bounds: Bounds) -> str:
    """Return the error message that reading a file has reached the limit of written bytes, with advice."""
    return f"{bounds.path}: reading it wrote more than {bounds.disk / 1e6:.0f} MB to the disk: {ADVICE}"


def limit_message(error: BaseException) -> str:
    """Return the message for the user if a limit of this process caused an error: the limit of memory or of file size.

    The causes of the error (`__cause__`) are searched too. Each MemoryError counts as the limit of memory. The text is
    empty for other errors, and if this process has no limits.
    """
    if _bounds is None:
        return ""
    cause: BaseException | None = error
    while cause is not None:  # a reader may have replaced the original error by an error of its own
        if isinstance(cause, MemoryError):
            return f"{_bounds.path}: reading it took more than {_bounds.memory / 1e9:.1f} GB of memory: {ADVICE}"
        if isinstance(cause, OSError) and cause.errno == errno.EFBIG:
            return _disk_message(_bounds)
        cause = cause.__cause__
    return ""


def _wait_for_child(child: int, incoming: int, bounds: Bounds, scratch: Path) -> NoReturn:
    """Wait until the child ends, delete the scratch files of a killed child, and end with its exit status.

    The child is killed if its temporary folder grows beyond the limit. If SIGINT, SIGTERM or SIGHUP ended the child,
    this process ends by the same signal. Only scratch files that are regular files are deleted.

    Parameters
    ----------
    child
        Process id of the child.
    incoming
        Pipe on which the child reports the names of its scratch files, each with a NUL at its end. It is closed when
        the child has ended.
    bounds
        Limits of the child.
    scratch
        Temporary folder of the child.

    Raises
    ------
    click.exceptions.Exit
        With the exit status of the child.
    SeatrialError
        If a limit killed the child, or if another signal ended it (a crash).
    """
    created, full = b"", False
    poll = select.poll()
    poll.register(incoming, select.POLLIN)
    while True:
        if poll.poll(1000 * WATCH_S):
            block = os.read(incoming, 1 << 16)
            if not block:  # the child has ended
                break
            created += block
        elif _disk_bytes(scratch) > bounds.disk:
            full = True
            os.kill(child, signal.SIGKILL)
            break
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status >= 0:
        raise click.exceptions.Exit(status)
    for left in filter(None, created.split(b"\0")):
        with contextlib.suppress(OSError):
            if stat.S_ISREG(os.lstat(left).st_mode):
                os.unlink(left)
    number = -status
    if full:
        raise SeatrialError(_disk_message(bounds))
    if number in SIGNALS:  # the user or the system has ended the command: this process ends by the same signal
        shutil.rmtree(scratch, ignore_errors=True)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    if number in (signal.SIGXCPU, signal.SIGKILL) and used.ru_utime + used.ru_stime >= bounds.cpu_s:
        raise SeatrialError(_time_message(bounds))
    name = signal.Signals(number).name if number in signal.valid_signals() else f"signal {number}"
    raise SeatrialError(f"{printable(str(bounds.path))}: the process that read the file was ended by {name}: {ADVICE}")


def _disk_bytes(folder: Path) -> int:
    """Return the number of bytes on the disk that the files in a folder and its subfolders use.

    The space of the blocks counts, not the length of a file. A link counts itself and not its target. The folders
    themselves and files that are deleted meanwhile count 0, and so does a folder that does not exist.
    """
    used = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):  # the file has been deleted in the meantime
                used += 512 * os.lstat(os.path.join(place, name)).st_blocks
    return used
