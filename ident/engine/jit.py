"""Just-in-time compilation of LLVM IR, the intermediate code of the compiler LLVM, to machine code.

Machine code is cached on disk under a hash of the IR, the processor and the version of LLVM.
"""

from __future__ import annotations

import hashlib
import os
import stat
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from platformdirs import user_cache_dir

try:
    import llvmlite.binding as llvm
except ImportError:  # llvmlite has no wheel for this machine; kernels are interpreted instead
    llvm = None

AVAILABLE = llvm is not None
# Passes over the IR, and level of the code generation. CasADi has already simplified the expressions of a kernel:
# passes over its IR and the code generation of level 2 only make its compilation longer.
KERNEL = ("none", 1)
# The same for `quick_compilation`: compilation takes a third of the time, and the code takes 1.1 times as long to run
QUICK = ("none", 0)
LOOPS = ("level 1", 2)  # for IR with loops and variables in memory, which the passes move to registers
# Rows in the records of a model. With more rows, quick compilation costs more than it saves: a refit with an effect has
# about 12 evaluations, which take 1.1 us longer for each row (20 states), and its compilation takes 0.28 s less
QUICK_ROWS = 20_000
# Options of LLVM's code generation. Instructions keep the order in which the IR has them: stages have thousands of
# instructions and fill all registers, so a scheduler that favours instructions in parallel adds a tenth more that only
# move values to and from the stack. A second scheduler takes a fifth of the compilation and makes the code no faster.
# LLVM ends the process if an option is unknown; versions above 22 were not tested.
OPTIONS = ("--pre-RA-sched=source", "--enable-misched=0") if AVAILABLE and llvm.llvm_version_info[0] <= 22 else ()
FRAME = '"frame-pointer"="all"'  # function attribute with which LLVM can align the stack for spilled vectors
NO_ROUTINES: Mapping[str, int] = {}
DIGEST_BYTES = 32
LARGEST_CACHE = 400_000_000  # bytes; above this size the least recently used files are deleted
KEPT_SHARE = 0.7  # share of LARGEST_CACHE that remains after the deletion
# Share of LARGEST_CACHE that is written between two scans of the folder. A scan is slow with ten thousand files
COUNT_SHARE = 0.01
_written: dict[Path, int] = {}  # bytes since the last scan, by folder; the first file of a process starts a scan


def _host_processor() -> tuple[str, str, int]:
    """Prepare LLVM for this machine. Return the processor's name, its features, and the doubles in a vector register.

    The number of doubles is 2, 4 or 8. Without llvmlite, the result is ("", "", 8).
    """
    if not AVAILABLE:
        return "", "", 8
    for option in OPTIONS:
        llvm.set_option("", option)
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    host = llvm.get_host_cpu_features()
    width = 8 if host.get("avx512f") else 4 if host.get("avx2") else 2
    features = host.flatten() + (",-prefer-256-bit" if width == 8 else "")
    return llvm.get_host_cpu_name(), features, width


CPU, FEATURES, WIDTH = _host_processor()


def cache_folder() -> Path:
    """Return the folder of the cache on disk, which holds machine code. It may not exist yet.

    It is the value of the environment variable ``SEATRIAL_CACHE`` if that is set and not empty. Otherwise it is
    ``seatrial/kernels`` in the user's cache folder of the operating system.
    """
    chosen = os.environ.get("SEATRIAL_CACHE")
    return Path(chosen) if chosen else Path(user_cache_dir("seatrial")) / "kernels"


_quick_contexts: list[object] = []
_of_thread = threading.local()  # has the attribute ``quick`` while this thread is inside `quick_kernel`


@contextmanager
def quick_compilation(n_rows: int) -> Iterator[None]:
    """Context in which kernels are compiled quickly, with less optimisation.

    The setting applies to all threads, as long as one of them is in such a context.

    It is meant for models that are fitted only once. Above 20 000 rows (`QUICK_ROWS`), it has no effect, because the
    slower code would cost more time than the compilation saves. Another process loads a kernel that was compiled in
    such a context only in such a context, too. In this process the kernel remains that of its model.

    Parameters
    ----------
    n_rows : int
        Number of rows of all records that the model is fitted to.
    """
    if n_rows > QUICK_ROWS:
        yield
        return
    token = object()
    _quick_contexts.append(token)
    try:
        yield
    finally:
        _quick_contexts.remove(token)


@contextmanager
def quick_kernel() -> Iterator[None]:
    """Context in which this thread compiles kernels quickly, and no other thread.

    It is meant for a kernel that runs a few times in a fit, so that its compilation takes longer than all of its runs.
    """
    before, _of_thread.quick = getattr(_of_thread, "quick", False), True
    try:
        yield
    finally:
        _of_thread.quick = before


def is_quick() -> bool:
    """Return whether this thread compiles kernels quickly at this moment.

    It does while any thread is inside `quick_compilation`, and while this thread is inside `quick_kernel`.
    """
    return bool(_quick_contexts) or getattr(_of_thread, "quick", False)


def _optimisation(has_loops: bool) -> tuple[str, int]:
    """Return the optimisation for a compilation at this moment: passes over the IR, and level of the code generation.

    The result is `LOOPS` if ``has_loops`` (loops and variables in memory, which the passes improve). Otherwise it is
    `QUICK` inside `quick_compilation` or `quick_kernel`, else `KERNEL`.
    """
    return LOOPS if has_loops else QUICK if is_quick() else KERNEL


def target() -> tuple[Any, ...]:
    """Return what machine code depends on besides the IR, for the keys of the cache.

    It is a tuple: version of LLVM (None without llvmlite), name and features of the processor, default optimisation,
    options of the code generation.
    """
    return (llvm.llvm_version_info if AVAILABLE else None, CPU, FEATURES, KERNEL, OPTIONS)


def machine_code_key(ir: str, has_loops: bool = False) -> str:
    """Return the SHA-256 hash (hexadecimal) under which the machine code of ``ir`` is stored in the cache on disk.

    It depends on the IR, on the machine (`target`) and on ``has_loops`` (see `load_machine_code`). If ``has_loops`` is
    false, it also depends on whether the thread compiles quickly (`is_quick`).
    """
    return hashlib.sha256(repr((*target(), _optimisation(has_loops), ir)).encode()).hexdigest()


def load_machine_code(
    ir: str, symbol: str, has_loops: bool = False, routines: Mapping[str, int] = NO_ROUTINES
) -> tuple[Any, int]:
    """Load the machine code of ``ir`` from the cache on disk. If the cache lacks it, compile and store it.

    Parameters
    ----------
    ir : str
        LLVM IR of a module, as text.
    symbol : str
        Name of the function of the module whose address is wanted.
    has_loops : bool
        Whether the function has inner loops and variables in memory, so that it needs more optimisation than a kernel.
    routines : Mapping[str, int]
        Addresses of the functions that the module declares, except those of the C library, by name.

    Returns
    -------
    library : object
        Linked library. The caller keeps a reference to it as long as the code is used.
    address : int
        Address of the function.

    Raises
    ------
    RuntimeError
        If llvmlite is not installed, or if the IR is invalid.
    """
    if not AVAILABLE:
        raise RuntimeError("llvmlite is not installed, so models cannot be compiled; pip install llvmlite")
    key = machine_code_key(ir, has_loops)
    cached = load_cached_machine_code(key, symbol, routines)
    if cached is not None:
        return cached
    machine_code = _compile(ir, has_loops)
    write_cache(f"{key}.o", machine_code)
    return _link_object_file(machine_code, key, symbol, routines)


def load_cached_machine_code(
    key: str, symbol: str, routines: Mapping[str, int] = NO_ROUTINES
) -> tuple[Any, int] | None:
    """Load machine code from the cache on disk.

    Parameters
    ----------
    key : str
        Result of `machine_code_key`.
    symbol : str
        Name of the function in the machine code whose address is wanted.
    routines : Mapping[str, int]
        As for `load_machine_code`.

    Returns
    -------
    tuple[object, int] or None
        Linked library, which the caller keeps as long as the code is used, and address of the function. None if the
        cache has no valid file with this machine code (`read_cache`), or if llvmlite is not installed.
    """
    machine_code = read_cache(f"{key}.o") if AVAILABLE else None
    return None if machine_code is None else _link_object_file(machine_code, key, symbol, routines)


def _link_object_file(machine_code: bytes, key: str, symbol: str, routines: Mapping[str, int]) -> tuple[Any, int]:
    """Link machine code, the content of an object file, under the name ``key``.

    ``routines`` are the addresses of functions that it calls, by name, except those of the C library. Return the linked
    library, and the address of its function ``symbol``. The address is valid as long as the library is referenced.
    ``key`` need not be unique, because each call links separately.
    """
    builder = llvm.JITLibraryBuilder().add_object_img(machine_code).add_current_process().export_symbol(symbol)
    for name, address in routines.items():
        builder.import_symbol(name, address)
    library = builder.link(llvm.create_lljit_compiler(_target_machine(KERNEL[1])), key)
    return library, int(library[symbol])


def _target_machine(level: int) -> Any:
    """Return LLVM's code generator for this processor, with the optimisation ``level`` (0 to 3)."""
    return llvm.Target.from_default_triple().create_target_machine(CPU, FEATURES, level, jit=True)


def _compile(ir: str, has_loops: bool) -> bytes:
    """Check the IR of a module, optimise it for this processor, and compile it. Return the content of the object file.

    ``has_loops``: whether the IR has loops and variables in memory, which need more optimisation. RuntimeError is
    raised for invalid IR.
    """
    chosen, level = _optimisation(has_loops)
    machine = _target_machine(level)
    module = llvm.parse_assembly(ir)
    module.verify()
    if chosen == "level 1":
        builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
        builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def read_cache(name: str) -> bytes | None:
    """Return the content of a file of the cache, and mark the file as used by setting its time of change to now.

    Parameters
    ----------
    name : str
        Name of the file in `cache_folder`.

    Returns
    -------
    bytes or None
        Content as given to `write_cache`. None if the file is missing or damaged (the SHA-256 that `write_cache` put
        before the content differs), or if another user may write to it or to its folder. Errors of the operating system
        are not raised.

    Notes
    -----
    The content is executed as machine code. Files that another user may have written are therefore ignored.
    """
    try:
        path = cache_folder() / name
        if not (_only_we_can_write(path) and _only_we_can_write(path.parent)):
            return None
        content = path.read_bytes()
        os.utime(path)  # `_delete_least_recently_used` deletes the least recently used files
    except (OSError, RuntimeError):  # RuntimeError: the user has no home folder
        return None
    digest, data = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
    return data if hashlib.sha256(data).digest() == digest else None


def _only_we_can_write(path: Path) -> bool:
    """Return whether only this user and the administrator can write to the file or folder ``path``.

    Its owner must be one of the two, and neither the group nor others may have the permission to write. OSError is
    raised if the path does not exist.
    """
    about = path.stat()
    return about.st_uid in (os.geteuid(), 0) and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def write_cache(name: str, content: bytes) -> None:
    """Store a file with this name and content in the cache on disk, for later processes.

    The SHA-256 of the content is put before it. A file of the same name is replaced as a whole, so that other processes
    never read a part of it. Only this user can read and write the file.

    If the cache exceeds 400 MB, its least recently used files are deleted. The size is checked at the first file of a
    process and then after every 4 MB. A cache that cannot be written is not an error.
    """
    try:
        folder = cache_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        scratch = folder / f"{name}.{os.getpid()}"  # renamed at the end, so that no process reads half a file
        scratch.write_bytes(hashlib.sha256(content).digest() + content)
        scratch.chmod(0o600)
        scratch.replace(folder / name)
        _written[folder] = _written.get(folder, LARGEST_CACHE) + len(content)
        if _written[folder] > COUNT_SHARE * LARGEST_CACHE:
            _written[folder] = 0
            _delete_least_recently_used(folder)
    except (OSError, RuntimeError):
        return


def _delete_least_recently_used(folder: Path) -> None:
    """Delete the least recently used files of the cache folder, if their total size exceeds 400 MB (`LARGEST_CACHE`).

    Files are deleted until at most 70 % of this size remain. All files of the folder count, whoever wrote them. One
    that cannot be deleted is left. Each nonparametric effect and each change of a user-defined model adds files, which
    would fill the disk without a limit.
    """
    with os.scandir(folder) as entries:
        files = [(about.st_mtime, about.st_size, f.path) for f in entries for about in (f.stat(),)]
    total = sum(size for _, size, _ in files)
    if total <= LARGEST_CACHE:
        return
    for _, size, path in sorted(files):
        try:
            Path(path).unlink(missing_ok=True)
        except OSError:  # a file of another user, or a folder
            continue
        total -= size
        if total <= KEPT_SHARE * LARGEST_CACHE:
            return
