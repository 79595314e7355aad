"""Just-in-time compilation of LLVM IR; machine code is cached by a hash of the IR, the processor and LLVM's version."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

try:
    import llvmlite.binding as llvm
except ImportError:  # no wheel for this machine: kernels are interpreted then
    llvm = None

AVAILABLE = llvm is not None
OPTIMISE = 1  # level of the IR passes; -O2 takes longer and its code is slower
CODEGEN = 2  # level of the code generation
QUICK = 0  # level of both for `quickly`: a third of the time, and code that takes three quarters longer to run
QUICK_ROWS = 10_000  # of the records of a model, beyond which that costs more than it saves
# Of the instructions in a block. The default asks what the processor could do at once, and in stages of some thousand
# instructions, which leave the registers full, a tenth more of them then only put values away and fetch them again.
# An option that LLVM does not know would end the process, so none is given to an LLVM that it was not tried with.
ORDER = "--pre-RA-sched=fast" if AVAILABLE and llvm.llvm_version_info[0] <= 22 else ""
DIGEST_BYTES = 32
LARGEST_CACHE = 400_000_000  # bytes; beyond that what was not used for longest goes
KEPT_SHARE = 0.7  # of the cache that then stays
COUNT_SHARE = 0.01  # of it that is written until its files are counted again, of which there may be ten thousand
_written: dict[Path, int] = {}  # bytes since then, by folder; the first file of a process is counted, too


def _host() -> tuple[str, str, int]:
    """Processor, its features, and how many doubles its vector registers hold."""
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
    """Where machine code is kept: ``SEATRIAL_CACHE``, or kernels in the user's cache folder."""
    chosen = os.environ.get("SEATRIAL_CACHE")
    return Path(chosen) if chosen else Path.home() / ".cache" / "seatrial" / "kernels"


_quickly: list[object] = []


@contextmanager
def quickly(n_rows: int) -> Iterator[None]:
    """Kernels compiled meanwhile, in whatever thread, are made in a hurry: for models that are fitted once, to as many
    rows, if these are few."""
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
    """Of the passes and of the code generation."""
    return (QUICK, QUICK) if _quickly else (OPTIMISE, CODEGEN)


def target() -> tuple[Any, ...]:
    """What machine code depends on beside the IR."""
    return (llvm.llvm_version_info if AVAILABLE else None, CPU, FEATURES, OPTIMISE, CODEGEN, ORDER)


def machine_code_key(ir: str) -> str:
    """The name of the machine code of ``ir``."""
    return hashlib.sha256(repr((*target(), _levels(), ir)).encode()).hexdigest()


def load_machine_code(ir: str, symbol: str) -> tuple[Any, int]:
    """The library made of ``ir`` (keep it as long as the code is used) and the address of ``symbol``."""
    if not AVAILABLE:
        raise RuntimeError("llvmlite is not installed, so nothing can be compiled")
    key = machine_code_key(ir)
    known = load_known(key, symbol)
    if known is not None:
        return known
    machine_code = _compile(ir)
    write_cache(f"{key}.o", machine_code)
    return _link(machine_code, key, symbol)


def load_known(key: str, symbol: str) -> tuple[Any, int] | None:
    """The same by the name of the machine code; None where it is not at hand."""
    machine_code = read_cache(f"{key}.o") if AVAILABLE else None
    return None if machine_code is None else _link(machine_code, key, symbol)


def _link(machine_code: bytes, key: str, symbol: str) -> tuple[Any, int]:
    builder = llvm.JITLibraryBuilder().add_object_img(machine_code).add_current_process().export_symbol(symbol)
    library = builder.link(llvm.create_lljit_compiler(_machine()), key)
    return library, int(library[symbol])


def _machine() -> Any:
    return llvm.Target.from_default_triple().create_target_machine(CPU, FEATURES, _levels()[1], jit=True)


def _compile(ir: str) -> bytes:
    machine = _machine()
    module = llvm.parse_assembly(ir)
    module.verify()
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=_levels()[0]))
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


def read_cache(name: str) -> bytes | None:
    """A file of the cache; None if it is not there, not as it was written, or where somebody else may write: what is
    in it is run."""
    try:
        path = cache_folder() / name
        if not (_is_ours(path) and _is_ours(path.parent)):
            return None
        content = path.read_bytes()
        os.utime(path)  # so that what is used stays
    except (OSError, RuntimeError):  # RuntimeError: the user has no home
        return None
    digest, kept = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
    return kept if hashlib.sha256(kept).digest() == digest else None


def _is_ours(path: Path) -> bool:
    """Whether only this user, or the administrator, can have written there."""
    about = path.stat()
    return about.st_uid in (os.geteuid(), 0) and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def write_cache(name: str, content: bytes) -> None:
    """Keep a file for the next process. A cache that cannot be written is not an error."""
    try:
        folder = cache_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        scratch = folder / f"{name}.{os.getpid()}"
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
    """Nonparametric effects and user models are compiled anew each time: without a limit they would fill the disk."""
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
