"""A user's own Python files: models and effects that seatrial does not have."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

from daq.errors import SeatrialError
from ident.model import Effect


def load_python(path: Path) -> ModuleType:
    """Run a Python file and return what it defines. Raises SeatrialError with the file and the reason."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise SeatrialError(f"{path}: no such Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as problem:
        raise SeatrialError(f"{path}: cannot be loaded: {problem}") from problem
    return module


def own_effects(path: Path) -> dict[str, Effect]:
    """The effects of a file: those in its ``EFFECT`` or ``EFFECTS``, by name."""
    module = load_python(path)
    found = getattr(module, "EFFECTS", None) or ((module.EFFECT,) if hasattr(module, "EFFECT") else ())
    if not found or not all(isinstance(e, Effect) for e in found):
        raise SeatrialError(f"{path}: defines neither EFFECT nor EFFECTS of ident.model.Effect")
    return {e.name: e for e in found}
