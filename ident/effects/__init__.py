"""The catalogue of effects: one file each, found by being there.

Each module defines ``EFFECT`` (an ``ident.model.Effect``) or ``EFFECTS`` (several). ``catalogue()`` imports
them all, so a new effect is one new file and its test.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from ident.model import Effect


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by name, in alphabetical order."""
    found: dict[str, Effect] = {}
    for module_info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{module_info.name}")
        for effect in getattr(module, "EFFECTS", ()) or (module.EFFECT,):
            if effect.name in found:
                raise ValueError(f"two effects are called {effect.name!r}")
            found[effect.name] = effect
    return dict(sorted(found.items()))
