"""User-defined models and effects, loaded from Python files and validated.

A Python file that is given on the command line is run. A Python file that a model.toml names is run under three
conditions (`trusted_file`): it lies in the folder of the model.toml, it is unchanged, and this user has run it before.
The option `--trust-code` replaces the conditions. The hashes of files that were run are stored in a file of the user
(`known_file`). The author of a folder can write its model.toml, but not this file of hashes.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import inspect
import os
from collections.abc import Collection, Iterator
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import Any

from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import append_to
from seatrial.ident.model import Effect, Model

# Parts of the error messages of libraries that are called with symbols, and the advice for the user
ADVICE = {
    "truth value": "`if`, `and`, `or`, `max` and `min` cannot decide on a symbol; write np.where(condition, a, b), "
    "np.maximum(a, b) or x * (x > 0)",
    "new_SX": "one of the returned rates or outputs is not a number; return a number or an expression of the arguments "
    "for each",
    "to_int not defined": "`int` and `range` cannot take a symbol; write np.floor(x)",
}


_TRUST: ContextVar[bool] = ContextVar("trust_code", default=False)
_ACCEPTED: ContextVar[frozenset[str]] = ContextVar("accepted_code", default=frozenset())


@contextlib.contextmanager
def trusting_code() -> Iterator[None]:
    """Return a context manager inside which any Python file that a model.toml names may be run.

    The hash of each file that is used inside is stored (`remember_trusted_file`). After the context, such a file still
    counts as run by this user. It may then be run without `--trust-code` if two more conditions are fulfilled: the
    model.toml contains its present hash, and it is in the folder of the model.toml (`trusted_file`). At the end, the
    state before is restored, so that contexts may be nested. The option `--trust-code` uses this context.
    """
    before = _TRUST.set(True)
    try:
        yield
    finally:
        _TRUST.reset(before)


@contextlib.contextmanager
def accepting_code(digests: Collection[str]) -> Iterator[None]:
    """Return a context manager inside which the Python files with these hashes (`code_digest`) may be run.

    A worker process uses it for the files that the process of the command has checked already. A worker on another
    computer has no list of files that the user has run. A file with another hash is checked as usual.
    """
    before = _ACCEPTED.set(frozenset(digests))
    try:
        yield
    finally:
        _ACCEPTED.reset(before)


def trusted_file(named_by: Path, file: str, digest: str | None) -> Path:
    """Return the path of the Python file that a model.toml names, after checking that it may be run.

    Without `--trust-code`, the file must lie in the folder of model.toml after resolving symbolic links. It must have
    the hash in model.toml, and this user must have run it before. With `--trust-code`, the file need only exist; its
    hash is then stored as known, so that the last condition is fulfilled later without the option. A file that another
    process of the command has checked (`accepting_code`) need only exist, too.

    Parameters
    ----------
    named_by : Path
        Path of the model.toml.
    file : str
        Path of the Python file in model.toml, relative to the folder of model.toml.
    digest : str or None
        First 16 digits of the SHA-256 of the Python file, as stored in model.toml. None: model.toml has no hash, and
        the file may only be run with `--trust-code`.

    Returns
    -------
    Path
        Path of the Python file, normalised. The file itself is not run here.

    Raises
    ------
    SeatrialError
        If the file is missing or may not be run. The message states the violated condition.
    """
    folder, path = named_by.parent.resolve(), named_by.parent / file
    if not path.is_file():
        place = os.path.normpath(path)
        raise SeatrialError(f"{named_by}: {place}: no such Python file; the model was made with it, so put it there")
    normal_path = Path(os.path.normpath(path))
    if _TRUST.get():
        remember_trusted_file(normal_path)
        return normal_path
    if code_digest(path) in _ACCEPTED.get():
        return normal_path
    if not path.resolve().is_relative_to(folder):
        reason = "is not in its folder"
    elif digest is None:
        reason = "is named without its hash"
    elif file_digest(path) != digest:
        reason = "has changed since it was written"
    elif code_digest(path) not in _known_digests():
        reason = "was never run by you before"
    else:
        return normal_path
    raise SeatrialError(f"{named_by}: {normal_path} {reason}, so it is not run; read it, and run it with --trust-code")


def known_file() -> Path:
    """Return the path of the file with the hashes of Python files that this user has run. The file may not exist.

    It is the environment variable ``SEATRIAL_KNOWN_CODE``, or ``~/.local/state/seatrial/known-code``.
    """
    chosen = os.environ.get("SEATRIAL_KNOWN_CODE")
    return Path(chosen) if chosen else Path.home() / ".local" / "state" / "seatrial" / "known-code"


def remember_trusted_file(path: Path) -> None:
    """Append the SHA-256 of a Python file that the user trusts to the user's file of known hashes (`known_file`).

    From then on, a model.toml in the folder of the Python file that names it with its hash may run it without
    `--trust-code`. A hash that is known already is not added again. If the hash cannot be written, the Python file
    stays unknown, without an error. A missing Python file raises OSError.
    """
    digest = code_digest(path)
    if digest in _known_digests():
        return
    with contextlib.suppress(OSError, SeatrialError):
        known_file().parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with append_to(known_file()) as file:
            os.fchmod(file.fileno(), 0o600)
            file.write(f"{digest}\n")


def _known_digests() -> set[str]:
    """Return the SHA-256 hashes of the Python files that this user has run.

    Return the empty set if the file of hashes is missing or is not ASCII text. Return it also if another user may have
    written the file: it belongs to another user, or its group or all users may write it.
    """
    try:
        about = known_file().stat()
        if about.st_uid != os.getuid() or about.st_mode & 0o022:
            return set()
        return set(known_file().read_text(encoding="ascii").split())
    except (OSError, ValueError):
        return set()


def code_digest(path: Path) -> str:
    """Return the SHA-256 of a file's contents, as 64 hexadecimal digits. A missing file raises OSError."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def file_digest(path: Path) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of a file's contents. A missing file raises OSError."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def load_python(path: Path) -> ModuleType:
    """Run a Python file and return it as a module, which is not added to ``sys.modules``.

    Raises
    ------
    SeatrialError
        If the file is missing or raises an error. The message has the file, the line and the reason.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None:
        raise SeatrialError(f"{path}: no such Python file; correct the path")
    module = importlib.util.module_from_spec(spec)
    try:
        # The loader is not used, because it would run bytecode in the folder of the file instead of the file
        exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
    except Exception as problem:
        raise SeatrialError(
            f"{error_place(problem, path)}: cannot be loaded: {error_message(problem)}{_import_advice(problem, path)}"
        ) from problem
    return module


def _import_advice(problem: BaseException, path: Path) -> str:
    """Return what to do if the user's file ``path`` imports a module that Python does not find; "" for other errors.

    The folder of the file is not searched by an import, because the file is run as a part of this program.
    """
    if not isinstance(problem, ModuleNotFoundError) or not problem.name:
        return ""
    name = problem.name.partition(".")[0]
    if (path.parent / f"{name}.py").is_file() or (path.parent / name).is_dir():
        folder = path.parent.absolute()
        return (
            f"; {name} is beside this file, where Python does not look: set PYTHONPATH={folder}, or put both into one "
            "file, of which model.toml keeps a copy"
        )
    return f"; install this package, or add the folder that has {name}.py to PYTHONPATH"


def load_object(source: str) -> Any:
    """Run a Python file of the user and return an object that it defines.

    Parameters
    ----------
    source : str
        ``FILE.py:NAME``: path of the file, and name of the object.

    Returns
    -------
    Any
        The object. If it can be called, as a function or class, the result of calling it without arguments.

    Raises
    ------
    SeatrialError
        If the file cannot be loaded, has no such object, or if the call fails.
    """
    file, _, name = source.rpartition(":")
    module = load_python(Path(file))
    try:
        loaded = getattr(module, name)
        return loaded() if callable(loaded) else loaded
    except Exception as problem:
        raise SeatrialError(
            f"{error_place(problem, Path(file))}: {name} cannot be loaded: {error_message(problem)}"
        ) from problem


def load_effects(path: Path) -> dict[str, Effect]:
    """Run a Python file and return its effects by name.

    The effects are the entries of its variable ``EFFECTS``, or, if this is absent or empty, its variable ``EFFECT``. Of
    several effects with one name, only the last is returned.

    Raises
    ------
    SeatrialError
        If the file cannot be loaded, defines no effects, or one of them is no Effect.
    """
    module = load_python(path)
    effects = getattr(module, "EFFECTS", None) or ((module.EFFECT,) if hasattr(module, "EFFECT") else ())
    if not effects or not all(isinstance(e, Effect) for e in effects):
        raise SeatrialError(
            f"{path}: neither EFFECT nor EFFECTS is an effect or a list of effects; set EFFECT to a "
            "seatrial.ident.model.Effect, or EFFECTS to a list of them"
        )
    return {e.name: e for e in effects}


def effects_for(model: Model, path: Path) -> dict[str, Effect]:
    """Run a Python file and return its effects by name, after checking each with a model.

    Parameters
    ----------
    model : Model
        Model to which the effects may be added later. Each effect is added to it and evaluated once with symbols.
    path : Path
        Python file of the user.

    Returns
    -------
    dict
        All effects of the file. Those that the model cannot accept, for example because it lacks a signal, are not
        checked.

    Raises
    ------
    SeatrialError
        If the file cannot be loaded, or an effect cannot be evaluated. The message has the file, the line and the
        reason.
    """
    effects = load_effects(path)
    for effect in effects.values():
        if model.accepts(effect):
            check_user_model(model + effect, path)
    return effects


def check_user_model(model: Model, path: Path) -> Model:
    """Return the model unchanged, after calling its functions once with symbols, as every estimation does.

    Parameters
    ----------
    model : Model
        User-defined model, or a model with a user-defined effect.
    path : Path
        Python file of the user, for the message.

    Raises
    ------
    SeatrialError
        If a function fails. The message has the file, the line (if it is known) and the reason.
    """
    from seatrial.ident.engine import EkfGraphs

    try:
        EkfGraphs(model)
    except Exception as problem:
        raise SeatrialError(f"{error_place(problem, path, model)}: {error_message(problem)}") from problem
    return model


def error_place(problem: BaseException, path: Path, model: Model | None = None) -> str:
    """Return the place of an error in the user's Python file, ``FILE:LINE``.

    Parameters
    ----------
    problem : BaseException
        The error.
    path : Path
        Python file of the user.
    model : Model or None
        Model whose functions failed. It is used if no line of the file is in the traceback.

    Returns
    -------
    str
        For a syntax error, its file and line; this may be another file, which the user's file imports. For any other
        error, the last line of the user's file in the traceback. Without such a line, the first line of the function of
        ``model`` that sets the outputs (if the message is about an output) or the time derivatives. Only the file if no
        line is known.
    """
    if isinstance(problem, SyntaxError) and problem.lineno:
        return f"{problem.filename or path}:{problem.lineno}"
    lines, at = [], problem.__traceback__
    while at is not None:
        if _same_file(at.tb_frame.f_code.co_filename, path):
            lines.append(at.tb_lineno)
        at = at.tb_next
    if not lines and model is not None:
        label = "output" if " output " in str(problem) else "rate"
        lines = [line for name, stage in model.stages if name == label for line in _first_lines(stage, path)]
    return f"{path}:{lines[-1]}" if lines else str(path)


def _first_lines(function: Any, path: Path) -> list[int]:
    """Return the number of the first line of a function in the file ``path``, as a list of one number.

    The list is empty if the function is not defined in this file. Of a wrapped function (`functools.update_wrapper`),
    the function inside counts.
    """
    code = getattr(inspect.unwrap(function), "__code__", None)
    return [code.co_firstlineno] if code is not None and _same_file(code.co_filename, path) else []


def _same_file(file: str, path: Path) -> bool:
    """Return whether the paths ``file`` and ``path`` are the same file after resolving symbolic links."""
    return Path(file).resolve() == path.resolve()


def error_message(problem: BaseException) -> str:
    """Return the message for an error in the user's code, in one line. No file and no line number are added to it.

    If the error comes from the use of symbols, for example in an ``if``, the message is advice from `ADVICE`, or the
    text of the error with a hint. Otherwise it is the text of the error. The texts of ValueError, TypeError and similar
    types are clear alone; for other types, and for an empty text, the name of the type is put before it.
    """
    message = " ".join(str(problem).split())
    for fragment, advice in ADVICE.items():
        if fragment in message:
            return advice
    if "SX" in message:
        return f"{message} (the function is called with symbols of the type SX; use numpy's functions)"
    # messages of these types are clear without the name of the type
    clear = isinstance(problem, (ValueError, TypeError, AttributeError, ArithmeticError, ImportError, SyntaxError))
    return message if message and clear else f"{type(problem).__name__}: {message}"
