"""Linearisation of a fitted model about straight motion at a speed: matrices, poles, time constants, step responses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import SeatrialError
from seatrial.ident.estimation import SavedModel
from seatrial.ident.export.codegen import without_nuisance
from seatrial.ident.export.rates import Rates
from seatrial.ident.model import COMMAND, SHAFT_SPEED, is_of_thruster
from seatrial.ident.numerics import Array

BALANCED = 1e-6  # largest rate at the operating point, in the unit of each state per second
TRIALS = (0.1, 0.4, 0.8)  # initial values of the inputs: at zero the thrust has no slope


@dataclass(frozen=True, repr=False)
class Linearisation:
    """Linear model ``dx/dt = A (x - x0) + B (u - u0)`` about straight motion in still water.

    Attributes
    ----------
    speed : float
        Forward speed through the water [m/s].
    states, inputs : tuple of str
        Names of the n states (velocities and shafts) and m inputs.
    A : Array (n, n)
        Derivatives of the rates by the states [1/s, if both have the same unit].
    B : Array (n, m)
        Derivatives of the rates by the inputs.
    x0 : Array (n,)
        States of the operating point.
    u0 : Array (m,)
        Inputs that keep the operating point.
    delays : dict of str to float
        Dead time [s] of each input that the model delays. The matrices do not contain it.
    """

    speed: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    A: Array
    B: Array
    x0: Array
    u0: Array
    delays: Mapping[str, float]

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues (n,) of A [1/s], the slowest first: in the order of the size of their real part."""
        found = np.linalg.eigvals(self.A).astype(np.complex128)
        return found[np.argsort(np.abs(found.real), kind="stable")]

    @property
    def time_constants(self) -> Array:
        """Time constants (n,) [s] of the poles in their order: ``-1 / Re``.

        A negative time constant belongs to an unstable pole. That of an integrator is infinite.
        """
        real = self.poles.real
        return np.where(real == 0.0, np.inf, -1.0 / np.where(real == 0.0, 1.0, real))

    def __repr__(self) -> str:
        """Return speed, stability, poles and time constants as a few lines of text."""
        how = "stable" if self.stable else "not stable: a pole has no negative real part"
        lines = [f"<Linearisation at {self.speed:g} m/s, {how}>", f"states {', '.join(self.states)}"]
        lines.append(f"inputs {', '.join(self.inputs)}")
        for pole, constant in zip(self.poles, self.time_constants, strict=True):
            shown = f"{pole.real:.4g}" + (f" {pole.imag:+.4g}j" if pole.imag else "")
            lines.append(f"pole {shown} 1/s, time constant {constant:.4g} s")
        return "\n".join(lines)

    @property
    def stable(self) -> bool:
        """Whether all poles have a negative real part."""
        return bool((self.poles.real < 0.0).all())

    def step_response(self, name: str, t: Array) -> dict[str, Array]:
        """Return the response of each state to a unit step of an input at t = 0, without its dead time.

        Parameters
        ----------
        name : str
            Name of the input.
        t : Array (n_times,)
            Times [s], at least 0.

        Returns
        -------
        dict of str to Array (n_times,)
            Change of each state from the operating point, for a step of one unit of the input.

        Raises
        ------
        KeyError
            If the model has no such input.
        """
        from scipy.linalg import expm  # imported here, as it takes 0.3 s

        if name not in self.inputs:
            raise KeyError(f"the model has no input {name!r}; its inputs are {', '.join(self.inputs)}")
        n = len(self.states)
        # The exponential of the system with the constant input as a further state; A may be singular.
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n] = self.A, self.B[:, self.inputs.index(name)]
        found = np.array([expm(whole * moment)[:n, n] for moment in np.asarray(t, dtype=float)]).reshape(-1, n)
        return {state: found[:, k] for k, state in enumerate(self.states)}


def linearise(saved: SavedModel, speed: float) -> Linearisation:
    """Linearise a fitted model about straight motion at a forward speed in still water.

    The operating point is found first: the inputs, the sway speed and the shafts for which speed and yaw rate (zero)
    stay. If one thruster is weaker, the inputs differ. Disturbance forces and sensor errors are left out. Delayed
    copies of an input count as the input itself.

    Parameters
    ----------
    saved : SavedModel
        The fitted model.
    speed : float
        Forward speed through the water [m/s], not zero: at rest the quadratic terms have no slope.

    Raises
    ------
    SeatrialError
        If the model has no forward speed, if ``speed`` is zero or not finite, or if no operating point is found with
        shaft speeds and commands (inputs ``n_...``) from -1 to 1. Forces have no limit.
    """
    model, _ = without_nuisance(saved.model)
    rates = Rates(model)
    if "u" not in rates.names:
        raise SeatrialError(
            f"model {model.name} has no forward speed u among its states, so it has no such operating point; "
            "use a model with u, such as horizontal"
        )
    if not np.isfinite(speed) or speed == 0.0:
        raise SeatrialError(f"speed {speed:g} m/s: give a speed other than zero, at which the model has a slope")
    x0, u0 = _operating_point(rates, speed)
    for name, value in zip(rates.inputs, u0, strict=True):
        if is_of_thruster(name, COMMAND, SHAFT_SPEED) and abs(value) > 1.0:
            raise SeatrialError(
                f"{speed:g} m/s needs {name} = {value:.2f}, more than full; choose a speed that the boat reaches"
            )
    A, B = (derivatives(x0[None], u0[None])[0] for derivatives in (rates.by_states, rates.by_inputs))
    values = model.values
    delays = {i: float(values["tau_n"]) for i in rates.inputs if "tau_n" in values and i in rates.delayed}
    return Linearisation(speed, rates.names, rates.inputs, A, B, x0, u0, delays)


def _operating_point(rates: Rates, speed: float) -> tuple[Array, Array]:
    """Return the states (n,) and inputs (m,) that keep straight motion at a forward speed [m/s] through the water.

    The surge speed has this value and the yaw rate is zero; the other states and the inputs are found by least squares
    of the rates. The limits of the inputs are not checked. If there are several such points, it is one of them.

    Raises
    ------
    SeatrialError
        If a rate above 1e-6 (in the unit of its state per second) remains.
    """
    from scipy.optimize import least_squares  # imported here, as it takes half a second

    m = len(rates.inputs)
    held = {"u": speed, "r": 0.0}
    free = [k for k, name in enumerate(rates.names) if name not in held]

    def unpacked(z: Array) -> tuple[Array, Array]:
        """Return the states (n,) and the inputs (m,) that the unknowns ``z`` stand for.

        ``z`` has the states that are not held, then the inputs. Held are the surge speed, ``speed``, and the yaw rate,
        which is zero.
        """
        x = np.array([held.get(name, 0.0) for name in rates.names])
        x[free] = z[: len(free)]
        return x, z[len(free) :]

    def residuals(z: Array) -> Array:
        """Return the rates (n,) at the unknowns ``z``."""
        x, u = unpacked(z)
        found: Array = rates(x[None], u[None])[0]
        return found

    best: Array | None = None
    smallest = np.inf
    for size in TRIALS:
        start = np.concatenate([np.zeros(len(free)), np.full(m, np.copysign(size, speed))])
        start[: len(free)] += [start[-1] if is_of_thruster(rates.names[k], SHAFT_SPEED) else 0.0 for k in free]
        found = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        if np.abs(found.fun).max(initial=0.0) < smallest:
            smallest, best = float(np.abs(found.fun).max(initial=0.0)), found.x
    if best is None or smallest > BALANCED:
        raise SeatrialError(
            f"no inputs keep straight motion at {speed:g} m/s: a rate of {smallest:.2g} per second remains; "
            "choose another speed"
        )
    return unpacked(best)
