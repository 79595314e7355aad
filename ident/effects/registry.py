"""Registry of the effect catalogue: one file for each effect, in folders by physical origin.

Each module defines ``EFFECT`` (a ``seatrial.ident.model.structure.Effect``) or ``EFFECTS`` (several). ``catalogue()``
imports all modules, so a new effect needs only a new file and its test. Other installed packages add effects by entry
points of the group ``seatrial.effects`` (``seatrial.daq.plugins``).
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType, ModuleType

import seatrial.ident.effects
from seatrial.daq.errors import SeatrialWarning
from seatrial.daq.plugins import load_or_warn, plugins
from seatrial.ident.model import Effect

GROUP = "seatrial.effects"  # entry points by which other packages add effects


@cache
def catalogue() -> Mapping[str, Effect]:
    """Return all effects by name, in alphabetical order. All callers share the mapping, so it is read-only.

    Effects of other packages are included. A package is left out with a warning if it cannot be imported, defines no
    effect, or uses the name of a built-in effect.
    """
    found: dict[str, Effect] = {}
    for folder in pkgutil.iter_modules(seatrial.ident.effects.__path__, "seatrial.ident.effects."):
        if folder.ispkg:
            for file in pkgutil.iter_modules(importlib.import_module(folder.name).__path__, f"{folder.name}."):
                _register(importlib.import_module(file.name), found)
    for point in plugins(GROUP).values():
        for effect in _effects_of(load_or_warn(point, object), point.value):
            if effect.name in found:
                warnings.warn(
                    f"the effect {effect.name!r} of {point.value} is left out: the name is in use; rename it",
                    SeatrialWarning,
                    stacklevel=2,
                )
            else:
                found[effect.name] = effect
    return MappingProxyType(dict(sorted(found.items())))


def _effects_of(loaded: object, place: str) -> tuple[Effect, ...]:
    """Return the effects that the object of an entry point contains: an Effect, a sequence of them, or a module."""
    if isinstance(loaded, ModuleType):
        loaded = getattr(loaded, "EFFECTS", None) or getattr(loaded, "EFFECT", None)
    effects = loaded if isinstance(loaded, (list, tuple)) else (loaded,)
    found = tuple(effect for effect in effects if isinstance(effect, Effect))
    if len(found) < len(effects) and loaded is not None:
        warnings.warn(
            f"{place} is left out: it has to be a seatrial.ident.model.Effect or a list of them",
            SeatrialWarning,
            stacklevel=3,
        )
        return ()
    return found


def _register(module: ModuleType, effects: dict[str, Effect]) -> None:
    """Add the effects of a module. Raise ValueError if a name is already in use."""
    for effect in getattr(module, "EFFECTS", ()) or (module.EFFECT,):
        if effect.name in effects:
            raise ValueError(f"two effects have the same name {effect.name!r}")
        effects[effect.name] = effect
