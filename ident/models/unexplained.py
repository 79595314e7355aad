"""Where unexplained forces act on a hull, and what they and the errors of its sensors may depend on: the hull's part of
a diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ident.model import Model, Residual, Signals, Variable


def adder(name: str) -> Callable[[Signals, Any], None]:
    """Adds an extra to the signal of this name."""

    def add(s: Signals, extra: Any) -> None:
        setattr(s, name, getattr(s, name) + extra)

    return add


def _reader(name: str) -> Callable[[Signals, Any], None]:
    """Adds an extra to the reading of this channel."""

    def add(s: Signals, extra: Any) -> None:
        s.y[name] = s.y[name] + extra

    return add


def _state(name: str) -> Callable[[Signals], Any]:
    return lambda s: getattr(s.x, name)


def _pair(letter: str, difference: bool) -> Callable[[Signals], Any]:
    def read(s: Signals) -> Any:
        left, right = getattr(s.u, f"{letter}_left"), getattr(s.u, f"{letter}_right")
        return left - right if difference else (left + right) / 2

    return read


TIME = Variable("t", "s", lambda s: s.u.t)
HULL = tuple(
    Residual(name, unit, f"b_{name}", scale, f"the force {name}", adder(name))
    for name, unit, scale in (("X", "N", 10.0), ("Y", "N", 10.0), ("N", "N m", 2.0))
)
# What a sensor may get wrong: a compass by the heading and by the motors' currents, the others by what shakes or turns
READINGS = tuple(
    Residual(name, unit, f"bias_{name}", scale, f"the reading of the {what}", _reader(name), "output", of)
    for name, what, unit, scale, of in (
        ("psi", "heading", "rad", 0.1, ("psi", "n_sum", "n_diff")),
        ("r", "yaw rate", "rad/s", 0.05, ("r",)),
        ("ax", "surge acceleration", "m/s2", 0.3, ("u", "r")),
        ("ay", "sway acceleration", "m/s2", 0.3, ("v", "r")),
    )
)
MOTION = (
    Variable("u", "m/s", _state("u"), functions=7),
    Variable("v", "m/s", _state("v")),
    Variable("r", "rad/s", _state("r")),
    Variable("psi", "rad", _state("psi"), angle=True),
    TIME,
)
SHAFTS = (Variable("n_sum", "", _pair("n", False)), Variable("n_diff", "", _pair("n", True)))
THRUSTS = (Variable("f_sum", "N", _pair("f", False)), Variable("f_diff", "N", _pair("f", True)))
PRODUCTS = (("u", "r"), ("u", "v"), ("v", "r"))


def residuals_of(model: Model) -> tuple[Residual, ...]:
    """Where something unexplained may enter; none for a model that cannot be diagnosed."""
    return model.residuals or (HULL if "hull" in model.provides else ())


def readings_of(model: Model) -> tuple[Residual, ...]:
    """The sensors whose readings may be off by more than the offsets that the model has for them."""
    states = {s.name for s in model.states}
    return tuple(r for r in READINGS if r.state in states) if "hull" in model.provides else ()


def variables_of(model: Model) -> tuple[Variable, ...]:
    """What residuals may depend on: the model's own list, or for a hull its motion, time and thrusters."""
    if model.variables or "hull" not in model.provides:
        return model.variables
    inputs = {i.name for i in model.inputs}
    shafts, thrusts = ({f"{letter}_left", f"{letter}_right"} <= inputs for letter in ("n", "f"))
    return MOTION + (SHAFTS if shafts else THRUSTS if thrusts else ())


def products_of(model: Model) -> tuple[tuple[str, str], ...]:
    """Pairs of variables whose products are tried too."""
    return model.products or (PRODUCTS if "hull" in model.provides else ())
