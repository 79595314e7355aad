"""User-defined models and effects, loaded from Python files and validated.

A Python file that was typed on the command line is run. One that a *file* names is run only from that file's own folder
and unchanged (`trusted_file`), and where this user has run it before, or with `--trust-code`. The hashes of files that
were run stand in a file of the user (`known_file`): the author of a folder writes its model.toml, but not that.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import inspect
import os
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import Any

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import append_to
from seatrial.ident.model import Effect, Model

# What libraries say of a symbol, and what to write instead
ADVICE = {
    "truth value": "`if`, `and`, `or`, `max` and `min` cannot decide on a symbol; write np.where(condition, a, b), "
    "np.maximum(a, b) or x * (x > 0)",
    "new_SX": "one of the rates or outputs that it gives is no number",
    "to_int not defined": "`int` and `range` cannot take a symbol; write np.floor(x)",
}


_TRUST: ContextVar[bool] = ContextVar("trust_code", default=False)


@contextlib.contextmanager
def trusting_code() -> Iterator[None]:
    """While it lasts, any Python file that a model.toml names is run, as with `--trust-code`."""
    before = _TRUST.set(True)
    try:
        yield
    finally:
        _TRUST.reset(before)


def trusted_file(named_by: Path, file: str, digest: str | None) -> Path:
    """The Python file that a model.toml, ``named_by``, names with its SHA-256 ``digest`` (the first 16 digits).

    It has to lie in the folder of model.toml, symbolic links resolved, to be what it was when that was written, and to
    be known from before; with `--trust-code` nothing of this, and it is known from then on. Raises SeatrialError,
    before anything of it is run.
    """
    folder, path = named_by.parent.resolve(), named_by.parent / file
    if not path.is_file():
        place = os.path.normpath(path)
        raise SeatrialError(f"{named_by}: {place}: no such Python file; the model was made with it, so put it there")
    found = Path(os.path.normpath(path))
    if _TRUST.get():
        remember(found)
        return found
    if not path.resolve().is_relative_to(folder):
        why = "is not in its folder"
    elif digest is None:
        why = "is named without its hash"
    elif file_digest(path) != digest:
        why = "has changed since it was written"
    elif _whole_digest(path) not in _known():
        why = "was never run by you before"
    else:
        return found
    raise SeatrialError(f"{named_by}: {found} {why}, so it is not run; read it, and run it with --trust-code")


def known_file() -> Path:
    """Return the file of hashes of Python that this user has run: ``SEATRIAL_KNOWN_CODE``, or one in the home."""
    chosen = os.environ.get("SEATRIAL_KNOWN_CODE")
    return Path(chosen) if chosen else Path.home() / ".local" / "state" / "seatrial" / "known-code"


def remember(path: Path) -> None:
    """Note the hash of a Python file of the user's own or trust; models that name it are run from then on.

    Where the note cannot be written, the file stays unknown.
    """
    digest = _whole_digest(path)
    if digest in _known():
        return
    with contextlib.suppress(OSError, SeatrialError):
        known_file().parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with append_to(known_file()) as file:
            os.fchmod(file.fileno(), 0o600)
            file.write(f"{digest}\n")


def _known() -> set[str]:
    """Return the hashes of known files; none where another user may have written them."""
    try:
        about = known_file().stat()
        if about.st_uid != os.getuid() or about.st_mode & 0o022:
            return set()
        return set(known_file().read_text(encoding="ascii").split())
    except (OSError, ValueError):
        return set()


def _whole_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def file_digest(path: Path) -> str:
    """The first 16 digits of a file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def load_python(path: Path) -> ModuleType:
    """Run a Python file and return what it defines. Raises SeatrialError with the file, its line and the reason."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None:
        raise SeatrialError(f"{path}: no such Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        # Not by the loader: that would take bytecode that lies beside the file for the file.
        exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
    except Exception as problem:
        raise SeatrialError(f"{error_place(problem, path)}: cannot be loaded: {error_message(problem)}") from problem
    return module


def load_object(source: str) -> Any:
    """What NAME of ``FILE.py:NAME`` is; a function is called. Raises SeatrialError."""
    file, _, name = source.rpartition(":")
    module = load_python(Path(file))
    try:
        found = getattr(module, name)
        return found() if callable(found) else found
    except Exception as problem:
        raise SeatrialError(
            f"{error_place(problem, Path(file))}: {name} cannot be loaded: {error_message(problem)}"
        ) from problem


def load_effects(path: Path) -> dict[str, Effect]:
    """The effects of a file: those in its ``EFFECT`` or ``EFFECTS``, by name."""
    module = load_python(path)
    found = getattr(module, "EFFECTS", None) or ((module.EFFECT,) if hasattr(module, "EFFECT") else ())
    if not found or not all(isinstance(e, Effect) for e in found):
        raise SeatrialError(f"{path}: defines neither EFFECT nor EFFECTS of seatrial.ident.model.structure.Effect")
    return {e.name: e for e in found}


def effects_for(model: Model, path: Path) -> dict[str, Effect]:
    """The effects that a Python file defines, each tried on the model where the model can have it.

    Raises SeatrialError with file, line and reason where one cannot be evaluated.
    """
    found = load_effects(path)
    for effect in found.values():
        if model.accepts(effect):
            check_user_model(model + effect, path)
    return found


def check_user_model(model: Model, path: Path) -> Model:
    """The model, after its functions of ``path`` have been called once with symbols, as every estimate does.

    Raises SeatrialError with file, line, what is wrong there, and what to write instead.
    """
    from seatrial.ident.engine import EkfGraphs

    try:
        EkfGraphs(model)
    except Exception as problem:
        raise SeatrialError(f"{error_place(problem, path, model)}: {error_message(problem)}") from problem
    return model


def error_place(problem: BaseException, path: Path, model: Model | None = None) -> str:
    """``FILE:LINE`` of the last line of the user's own that led to the problem; without one, of the function that ends
    the model's rates or outputs."""
    if isinstance(problem, SyntaxError) and problem.lineno:
        return f"{problem.filename or path}:{problem.lineno}"
    lines, at = [], problem.__traceback__
    while at is not None:
        if _same(at.tb_frame.f_code.co_filename, path):
            lines.append(at.tb_lineno)
        at = at.tb_next
    if not lines and model is not None:
        label = "output" if " output " in str(problem) else "rate"
        lines = [line for name, stage in model.stages if name == label for line in _first_line(stage, path)]
    return f"{path}:{lines[-1]}" if lines else str(path)


def _first_line(function: Any, path: Path) -> list[int]:
    code = getattr(inspect.unwrap(function), "__code__", None)
    return [code.co_firstlineno] if code is not None and _same(code.co_filename, path) else []


def _same(file: str, path: Path) -> bool:
    return Path(file).resolve() == path.resolve()


def error_message(problem: BaseException) -> str:
    """What to say of an error in the user's own code."""
    said = " ".join(str(problem).split())
    for sign, advice in ADVICE.items():
        if sign in said:
            return advice
    if "SX" in said:
        return f"{said} (SX are the symbols that it is called with: write it with numpy's functions)"
    plain = isinstance(problem, (ValueError, TypeError, AttributeError, ArithmeticError, ImportError, SyntaxError))
    return said if said and plain else f"{type(problem).__name__}: {said}"
