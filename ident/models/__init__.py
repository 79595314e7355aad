"""Models of boats, thrusters and sensors, one file each, and how to make one by name."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from daq.errors import SeatrialError
from ident.model import Model

BUILT_IN = ("horizontal", "surge", "yaw", "thruster")


def make_model(source: str, sensors: Sequence[str] | None = None) -> Model:
    """A model by name: ``horizontal:shaft``, ``horizontal:force:still``, ``surge``, or ``FILE.py:NAME``, where NAME
    is a Model or a function that returns one. ``sensors`` leaves out those that a log does not have.

    Raises SeatrialError when there is no such model.
    """
    if ".py:" in source:
        return _own_model(source)
    kind, *options = source.split(":")
    if kind not in BUILT_IN:
        raise SeatrialError(f"no model {source!r}: there are {', '.join(BUILT_IN)}, or FILE.py:NAME for your own")
    if kind == "horizontal":
        from ident.models.horizontal import SENSORS, horizontal

        propulsion: Any = next((o for o in options if o in ("shaft", "force", "general")), "shaft")
        chosen = [s for s in SENSORS if s in sensors] if sensors is not None else None
        current = "still" not in options
        return (
            horizontal(propulsion, tuple(chosen), current=current)
            if chosen
            else horizontal(propulsion, current=current)
        )
    module = importlib.import_module(f"ident.models.{kind}")
    maker: Callable[..., Model] = getattr(module, kind)
    return maker()


def _own_model(source: str) -> Model:
    file, _, name = source.rpartition(":")
    path = Path(file)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise SeatrialError(f"{file}: no such file for --model {source}")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        found = getattr(module, name)
        model = found() if callable(found) else found
    except Exception as problem:
        raise SeatrialError(f"{file}: {name} cannot be loaded: {problem}") from problem
    if not isinstance(model, Model):
        raise SeatrialError(f"{file}: {name} is no ident.model.Model but {type(model).__name__}")
    return model
