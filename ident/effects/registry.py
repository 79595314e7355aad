"""Registry of the effects in the catalogue, one file each, in folders by physical origin.

Each module defines ``EFFECT`` (a ``seatrial.ident.model.structure.Effect``) or ``EFFECTS`` (several effects).
``catalogue()`` imports all modules, so a new effect needs only one new file and its test.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType, ModuleType

import seatrial.ident.effects
from seatrial.ident.model import Effect


@cache
def catalogue() -> Mapping[str, Effect]:
    """Return all effects of the catalogue by name, in alphabetical order. The mapping is read-only, because all
    callers share it.
    """
    effects: dict[str, Effect] = {}
    for folder in pkgutil.iter_modules(seatrial.ident.effects.__path__, "seatrial.ident.effects."):
        if folder.ispkg:
            for file in pkgutil.iter_modules(importlib.import_module(folder.name).__path__, f"{folder.name}."):
                _register(importlib.import_module(file.name), effects)
    return MappingProxyType(dict(sorted(effects.items())))


def _register(module: ModuleType, effects: dict[str, Effect]) -> None:
    """Add the effects of a module. Raise ValueError if a name is already in use."""
    for effect in getattr(module, "EFFECTS", ()) or (module.EFFECT,):
        if effect.name in effects:
            raise ValueError(f"two effects are called {effect.name!r}")
        effects[effect.name] = effect
