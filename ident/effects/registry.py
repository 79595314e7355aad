"""Registry of the effect catalogue: one file for each effect, in folders by physical origin.

Each module defines ``EFFECT`` (a ``seatrial.ident.model.structure.Effect``) or ``EFFECTS`` (several). ``catalogue()``
imports all modules, so a new effect needs only a new file and its test. Other installed packages add effects by entry
points of the group ``seatrial.effects`` (``seatrial.daq.plugins``).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import MappingProxyType, ModuleType

import seatrial.ident.effects
from seatrial.daq.errors import warn
from seatrial.daq.plugins import load_or_warn, plugins
from seatrial.ident.model import Effect, built_in

GROUP = "seatrial.effects"  # entry points by which other packages add effects


@cache
def catalogue() -> Mapping[str, Effect]:
    """Return all effects by name, in alphabetical order: the built-in ones, and those of other installed packages.

    The modules of the effects are imported at the first call. The result is kept and shared by all callers, so it is
    read-only. A package is left out with a warning if it cannot be imported, or if its entry point names anything else
    than effects (without a warning for a module that has neither ``EFFECTS`` nor ``EFFECT``). An effect of a package is
    left out with a warning if its name is in use.

    Raises
    ------
    ValueError
        If two built-in effects have the same name.
    """
    found: dict[str, Effect] = {}
    for folder in pkgutil.iter_modules(seatrial.ident.effects.__path__, "seatrial.ident.effects."):
        if folder.ispkg:
            for file in pkgutil.iter_modules(importlib.import_module(folder.name).__path__, f"{folder.name}."):
                _register_module(importlib.import_module(file.name), found)
    for point in plugins(GROUP).values():
        for effect in _effects_of_plugin(load_or_warn(point, object), point.value):
            if effect.name in found:
                warn(
                    f"the effect {effect.name!r} of the package {point.value} is left out, because another effect has "
                    "this name; rename it"
                )
            else:
                found[effect.name] = effect
    return MappingProxyType(dict(sorted(found.items())))


def values_without(name: str) -> dict[str, float]:
    """Return the values of the parameters of an effect without which it changes nothing, by name.

    They are empty for an effect that the catalogue lacks.
    """
    effect = catalogue().get(name)
    return {} if effect is None else {p.name: p.value for p in effect.parameters}


def is_special_case(first: str, second: str) -> bool:
    """Return whether one of two effects of the catalogue is a special case of the other (`Effect.nests`), by name.

    No experiment tells such effects apart. An effect is a special case of itself. A name that is not in the catalogue
    has no special cases.
    """
    known = catalogue()
    return first == second or any(
        general in known and special in known[general].nests for general, special in ((first, second), (second, first))
    )


def separating_experiment(first: str, second: str) -> str:
    """Return what distinguishes two effects of the catalogue that a mission of thruster commands may not distinguish.

    The effects are given by name, in any order. The result is that of `Effect.separated_by`, a clause for reports. It
    is empty if a mission may distinguish them, or if a name is not in the catalogue.
    """
    known = catalogue()
    texts = (known[a].separated_by.get(b, "") for a, b in ((first, second), (second, first)) if a in known)
    return next(filter(None, texts), "")


def _effects_of_plugin(loaded: object, place: str) -> tuple[Effect, ...]:
    """Return the effects in the object that an entry point of another installed package names.

    Parameters
    ----------
    loaded : object
        An Effect, a list or tuple of Effects, or a module with ``EFFECTS`` or ``EFFECT``. None: the entry point could
        not be imported.
    place : str
        Text of the entry point (module and name), for messages.

    Returns
    -------
    tuple[Effect, ...]
        () with a warning if the object, or a single element of it, is no Effect. () without a warning for None, for an
        empty list, and for a module that has neither ``EFFECTS`` nor ``EFFECT``.
    """
    if isinstance(loaded, ModuleType):
        loaded = getattr(loaded, "EFFECTS", None) or getattr(loaded, "EFFECT", None)
    effects = loaded if isinstance(loaded, (list, tuple)) else (loaded,)
    found = tuple(effect for effect in effects if isinstance(effect, Effect))
    if len(found) < len(effects) and loaded is not None:
        warn(
            f"the effects of the package {place} are left out; name a seatrial.ident.model.Effect, or a list of them, "
            "in its entry point"
        )
        return ()
    return found


def _register_module(module: ModuleType, effects: dict[str, Effect]) -> None:
    """Add the effects of a module (``EFFECTS``, otherwise ``EFFECT``) to the mapping ``effects`` by name, in place.

    The origin of their parameter values is set to built-in, if it is "given" (the default): reports then do not count
    them as given by the user.

    Raises
    ------
    ValueError
        If a name is already in use.
    AttributeError
        If the module has neither ``EFFECTS`` nor ``EFFECT``.
    """
    for effect in getattr(module, "EFFECTS", ()) or (module.EFFECT,):
        if effect.name in effects:
            raise ValueError(f"two effects of the catalogue are called {effect.name!r}; rename one of them")
        effects[effect.name] = replace(effect, parameters=built_in(effect.parameters))
