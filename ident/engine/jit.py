"""Just-in-time compilation of LLVM IR.

Machine code is cached under a hash of the IR, the processor and the version of LLVM.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from platformdirs import user_cache_dir

try:
    import llvmlite.binding as llvm
except ImportError:  # llvmlite has no wheel for this machine; kernels are interpreted instead
    llvm = None

AVAILABLE = llvm is not None
OPTIMISE = 1  # level of the IR passes; -O2 takes longer and its code is slower
CODEGEN = 2  # level of the code generation
# Level of both for `quick_compilation`: compilation takes a third of the time, and the code takes three quarters longer
# to run
QUICK = 0
QUICK_ROWS = 10_000  # rows in the records of a model; with more rows, quick compilation costs more than it saves
# Scheduler of the instructions in a block. The default scheduler favours instructions that can run in parallel. The
# stages have thousands of instructions and fill all registers, so the default adds a tenth more instructions that only
# spill and reload values. LLVM ends the process if an option is unknown; versions above 22 were not tested.
ORDER = "--pre-RA-sched=fast" if AVAILABLE and llvm.llvm_version_info[0] <= 22 else ""
DIGEST_BYTES = 32
LARGEST_CACHE = 400_000_000  # bytes; above this size the least recently used files are deleted
KEPT_SHARE = 0.7  # share of LARGEST_CACHE that remains after the deletion
# Share of LARGEST_CACHE that is written between two scans of the folder. A scan is slow with ten thousand files
COUNT_SHARE = 0.01
_written: dict[Path, int] = {}  # bytes since the last scan, by folder; the first file of a process starts a scan


def _host() -> tuple[str, str, int]:
    """Return the processor, its features, and the number of doubles in a vector register."""
    if not AVAILABLE:
        return "", "", 8
    if ORDER:
        llvm.set_option("", ORDER)
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    host = llvm.get_host_cpu_features()
    width = 8 if host.get("avx512f") else 4 if host.get("avx2") else 2
    features = host.flatten() + (",-prefer-256-bit" if width == 8 else "")
    return llvm.get_host_cpu_name(), features, width


CPU, FEATURES, WIDTH = _host()


def cache_folder() -> Path:
    """Return the folder of cached machine code: ``SEATRIAL_CACHE``, or the user's cache folder of this system."""
    chosen = os.environ.get("SEATRIAL_CACHE")
    return Path(chosen) if chosen else Path(user_cache_dir("seatrial")) / "kernels"


_quickly: list[object] = []


@contextmanager
def quick_compilation(n_rows: int) -> Iterator[None]:
    """Compile kernels quickly, with less optimisation, inside this context. The setting applies to all threads.

    Use it for models that are fitted only once. Above `QUICK_ROWS` rows, the context has no effect.

    Parameters
    ----------
    n_rows : int
        Number of rows of all records that the model is fitted to.
    """
    if n_rows > QUICK_ROWS:
        yield
        return
    token = object()
    _quickly.append(token)
    try:
        yield
    finally:
        _quickly.remove(token)


def _levels() -> tuple[int, int]:
    """Return the optimisation levels of the IR passes and of the code generation."""
    return (QUICK, QUICK) if _quickly else (OPTIMISE, CODEGEN)


def target() -> tuple[Any, ...]:
    """Return what the machine code depends on, besides the IR: LLVM's version, processor and options."""
    return (llvm.llvm_version_info if AVAILABLE else None, CPU, FEATURES, OPTIMISE, CODEGEN, ORDER)


def machine_code_key(ir: str) -> str:
    """Return the hash that names the machine code of ``ir`` in the cache."""
    return hashlib.sha256(repr((*target(), _levels(), ir)).encode()).hexdigest()


def load_machine_code(ir: str, symbol: str) -> tuple[Any, int]:
    """Load or compile the machine code of ``ir``.

    Parameters
    ----------
    ir : str
        LLVM IR of a module.
    symbol : str
        Name of a function in the module.

    Returns
    -------
    library : object
        Linked library. The caller keeps a reference to it as long as the code is used.
    address : int
        Address of the function.

    Raises
    ------
    RuntimeError
        If llvmlite is not installed.
    """
    if not AVAILABLE:
        raise RuntimeError("llvmlite is not installed, so kernels cannot be compiled; install llvmlite")
    key = machine_code_key(ir)
    cached = load_known(key, symbol)
    if cached is not None:
        return cached
    machine_code = _compile(ir)
    write_cache(f"{key}.o", machine_code)
    return _link(machine_code, key, symbol)


def load_known(key: str, symbol: str) -> tuple[Any, int] | None:
    """Load machine code from the cache by its key. Return the library and the address of ``symbol``, or None if not
    cached.
    """
    machine_code = read_cache(f"{key}.o") if AVAILABLE else None
    return None if machine_code is None else _link(machine_code, key, symbol)


def _link(machine_code: bytes, key: str, symbol: str) -> tuple[Any, int]:
    builder = llvm.JITLibraryBuilder().add_object_img(machine_code).add_current_process().export_symbol(symbol)
    library = builder.link(llvm.create_lljit_compiler(_machine()), key)
    return library, int(library[symbol])


def _machine() -> Any:
    return llvm.Target.from_default_triple().create_target_machine(CPU, FEATURES, _levels()[1], jit=True)


def _compile(ir: str) -> bytes:
    """Return the object file of ``ir``."""
    machine = _machine()
    module = llvm.parse_assembly(ir)
    module.verify()
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=_levels()[0]))
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


def read_cache(name: str) -> bytes | None:
    """Return the content of a file of the cache.

    Returns
    -------
    bytes or None
        None if the file is missing or damaged, or if another user may write to it or to its folder.

    Notes
    -----
    The content is executed as machine code. Files that another user may have written are therefore ignored.
    """
    try:
        path = cache_folder() / name
        if not (_is_ours(path) and _is_ours(path.parent)):
            return None
        content = path.read_bytes()
        os.utime(path)  # `_prune` deletes the least recently used files
    except (OSError, RuntimeError):  # RuntimeError: the user has no home folder
        return None
    digest, data = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
    return data if hashlib.sha256(data).digest() == digest else None


def _is_ours(path: Path) -> bool:
    """Return whether only this user or the administrator can have written to the path."""
    about = path.stat()
    return about.st_uid in (os.geteuid(), 0) and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def write_cache(name: str, content: bytes) -> None:
    """Store a file in the cache for later processes. A cache that cannot be written is not an error."""
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
            _prune(folder)
    except (OSError, RuntimeError):
        return


def _prune(folder: Path) -> None:
    """Delete the least recently used files if the cache exceeds `LARGEST_CACHE`.

    Nonparametric effects and user models are compiled anew each time. Without a limit they would fill the disk.
    """
    with os.scandir(folder) as entries:
        files = [(about.st_mtime, about.st_size, f.path) for f in entries for about in (f.stat(),)]
    total = sum(size for _, size, _ in files)
    if total <= LARGEST_CACHE:
        return
    for _, size, path in sorted(files):
        Path(path).unlink(missing_ok=True)
        total -= size
        if total <= KEPT_SHARE * LARGEST_CACHE:
            return
