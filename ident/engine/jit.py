"""LLVM IR to machine code, kept on disk under a hash of the IR, the processor and LLVM's version."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

try:
    import llvmlite.binding as llvm
except ImportError:  # no wheel for this machine: kernels are interpreted then
    llvm = None

AVAILABLE = llvm is not None
OPTIMISE = 1  # of the IR passes; -O2 takes longer and its code is slower
CODEGEN = 2
DIGEST_BYTES = 32


def _host() -> tuple[str, str, int]:
    """Processor, its features, and how many doubles its vector registers hold."""
    if not AVAILABLE:
        return "", "", 8
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


def load(ir: str, symbol: str) -> tuple[Any, int]:
    """The library made of ``ir`` (keep it as long as the code is used) and the address of ``symbol``."""
    if not AVAILABLE:
        raise RuntimeError("llvmlite is not installed, so nothing can be compiled")
    key = hashlib.sha256(repr((llvm.llvm_version_info, CPU, FEATURES, OPTIMISE, CODEGEN, ir)).encode()).hexdigest()
    machine_code = _read(key)
    if machine_code is None:
        machine_code = _compile(ir)
        _write(key, machine_code)
    builder = llvm.JITLibraryBuilder().add_object_img(machine_code).add_current_process().export_symbol(symbol)
    library = builder.link(llvm.create_lljit_compiler(_machine()), key)
    return library, int(library[symbol])


def _machine() -> Any:
    return llvm.Target.from_default_triple().create_target_machine(CPU, FEATURES, CODEGEN, jit=True)


def _compile(ir: str) -> bytes:
    machine = _machine()
    module = llvm.parse_assembly(ir)
    module.verify()
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=OPTIMISE))
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


def _read(key: str) -> bytes | None:
    """Machine code from the cache; None if it is not there, or not as it was written."""
    try:
        content = (cache_folder() / f"{key}.o").read_bytes()
    except (OSError, RuntimeError):  # RuntimeError: the user has no home
        return None
    digest, machine_code = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
    return machine_code if hashlib.sha256(machine_code).digest() == digest else None


def _write(key: str, machine_code: bytes) -> None:
    """Keep machine code for the next process. A cache that cannot be written is not an error."""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        scratch = folder / f"{key}.{os.getpid()}"
        scratch.write_bytes(hashlib.sha256(machine_code).digest() + machine_code)
        scratch.replace(folder / f"{key}.o")
    except (OSError, RuntimeError):
        return
