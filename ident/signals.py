"""What the stages of a model share: states, inputs and parameters by name, and what each stage adds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any


class Named(SimpleNamespace):
    """Scalars, symbols or columns by name. AttributeError of a name that is not there says which there are."""

    _kind = "signal"

    def __getattr__(self, name: str) -> Any:  # only what is not there comes here
        there = ", ".join(vars(self)) or "none"
        raise AttributeError(f"no {self._kind} {name!r}; there is {there}", name=name, obj=self)


class States(Named):
    _kind = "state"


class Inputs(Named):
    _kind = "input"


class Parameters(Named):
    _kind = "parameter"


class Signals(Named):
    """``x``, ``u``, ``p`` by name, ``rate`` and ``y`` as dictionaries, and the rest as each model names it (vehicle
    models: ``n`` and ``f`` by thruster, ``X``, ``Y``, ``N``)."""

    x: Any
    u: Any
    p: Any
    rate: dict[str, Any]
    y: dict[str, Any]
