"""Columns for the score test: the catalogue's effects at zero, and what no catalogue lists."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import expm

from ident.dataset import Record
from ident.engine.rowwise import Rowwise
from ident.model import Effect, Model
from ident.score import Columns

Array = NDArray[np.float64]
FORCES = ("X", "Y", "N")


class Path:
    """A model along the filter's path on one record, for finite differences around it.

    ``record`` carries every input that a candidate may want; x (n_rows, n_states) the predicted states.
    """

    def __init__(self, model: Model, values: Array, record: Record, x: Array) -> None:
        self.model, self.values, self.record, self.x = model, values, record, x
        self.rowwise = Rowwise(model)
        self.own = record.for_model(model)
        self.base = self.rowwise(x, self.own.u, values)
        self.jacobian = self.rowwise.output_jacobian(x, self.own.u, values)

    def parameter(self, name: str) -> Array:
        """d(rates, outputs) / d parameter, (n_rows, n_states + n_outputs)."""
        index = [p.name for p in self.model.parameters].index(name)
        p = self.model.parameters[index]
        h = p.step or 0.01 * max(abs(self.values[index]), 1e-3)
        up, down = self.values.copy(), self.values.copy()
        up[index] += h / 2
        down[index] -= h / 2
        return (self.rowwise(self.x, self.own.u, up) - self.rowwise(self.x, self.own.u, down)) / h

    def state(self, name: str) -> Array:
        """d(rates, outputs) / d state; exact for the disturbance states, which enter linearly."""
        index = [s.name for s in self.model.states].index(name)
        moved = self.x.copy()
        moved[:, index] += 1.0
        change = self.rowwise(moved, self.own.u, self.values) - self.base
        change[:, index] = 0.0  # its own decay is not an effect on the boat
        return change

    def effect(self, effect: Effect) -> Iterator[Columns]:
        """One candidate, or one for each combination of its scanned parameters."""
        larger = self.model + effect
        n, m = len(self.model.states), len(effect.states)
        u, rowwise = self.record.for_model(larger).u, Rowwise(larger)
        for scan in product(*effect.scan.values()):
            tried = dict(zip(effect.scan, scan, strict=True))
            own = np.array([tried.get(p.name, p.value) for p in effect.parameters])
            values = np.append(self.values, own)
            x = np.column_stack([self.x, self._driven(rowwise, effect, values, u)]) if m else self.x
            base, delta, names = rowwise(x, u, values), [], []
            for j, p in enumerate(effect.parameters):
                if p.transform == "log" or p.name in tried or (j > 0 and p.value != 0.0):
                    continue  # shapes of the effect, not its size
                moved = values.copy()
                moved[len(self.values) + j] += p.step
                change = (rowwise(x, u, moved) - base) / p.step
                delta.append(np.delete(change, np.s_[n : n + m], axis=1))
                names.append(p.name)
            yield Columns(effect.name, np.stack(delta, axis=2), tuple(names), tried, one_sided=effect.one_sided)

    def _driven(self, rowwise: Rowwise, effect: Effect, values: Array, u: Array) -> Array:
        """The effect's own states, driven along the path while it is at zero (linear, constant coefficients)."""
        n, m = len(self.model.states), len(effect.states)
        x = np.column_stack([self.x, np.zeros((len(self.x), m))])
        drive = rowwise(x, u, values)[:, n : n + m]
        A = rowwise.rate_jacobian(x[:1], u[:1], values)[0, n:, n:]
        z = np.zeros((len(x), m))
        h = np.round(self.record.h, 9)
        steps = {step: _discrete(A, step) for step in np.unique(h)}
        for k in range(len(x) - 1):
            transition, weight = steps[h[k]]
            z[k + 1] = transition @ z[k] + weight @ (drive[k] + drive[k + 1]) / 2
        return z

    def generic(self, among: Mapping[str, Array] | None = None) -> Iterator[Columns]:
        """Each residual force as a smooth function of each variable, and of products; ``among``: see splines."""
        table = generic_features(self.model, self.own, self.x, among)
        for force in FORCES:
            direction = self.state(f"b_{force}")
            for name, feature in table.items():
                delta = direction[:, :, None] * feature[:, None, :]
                yield Columns(f"{force}({name})", delta, generic=True)


def _discrete(A: Array, step: float) -> tuple[Array, Array]:
    m = len(A)
    block = expm(np.block([[A, np.eye(m)], [np.zeros((m, 2 * m))]]) * step)
    return block[:m, :m], block[:m, m:]


def variables(model: Model, record: Record, x: Array) -> dict[str, Array]:
    """What a residual force may depend on, (n_rows,) each."""
    names = [s.name for s in model.states]
    found = {name: x[:, names.index(name)] for name in ("u", "v", "r")}
    found["psi"] = np.mod(x[:, names.index("psi")] + np.pi, 2 * np.pi) - np.pi
    found["t"] = record.t
    for letter in ("n", "f"):
        pair = [f"{letter}_left", f"{letter}_right"]
        if all(n in record.inputs for n in pair):
            left, right = (record.u[:, record.inputs.index(n)] for n in pair)
            found[f"{letter}_sum"], found[f"{letter}_diff"] = (left + right) / 2, left - right
            break
    return found


def generic_features(
    model: Model, record: Record, x: Array, among: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """Regressors by name: splines of single variables, harmonics of heading, products of velocities.

    ``among``: the variables of all records together, so that a column means the same in each of them.
    """
    v = variables(model, record, x)
    among = v if among is None else among
    psi = v.pop("psi")
    table = {
        name: feature for name, z in v.items() if (feature := splines(z, 6 if name != "u" else 7, among[name])).size
    }
    table["psi"] = np.column_stack([np.sin(psi), np.cos(psi), np.sin(2 * psi), np.cos(2 * psi)])
    for a, b in (("u", "r"), ("u", "v"), ("v", "r")):
        za, zb = v[a], v[b]
        table[f"{a}, {b}"] = np.column_stack([za * zb, np.abs(za) * zb, za * np.abs(zb)])
    return table


def splines(z: Array, n_functions: int, among: Array | None = None) -> Array:
    """Cubic B-splines of z over the middle 99 % of ``among`` (z itself by default), centred there; empty where that
    does not vary."""
    among = z if among is None else among
    low, high = np.percentile(among, [0.5, 99.5])
    if high - low < 1e-6:
        return np.zeros((z.size, 0))
    inner = np.linspace(0, 1, n_functions - 2)
    knots = np.concatenate([[0] * 3, inner, [1] * 3])
    basis, all_ = (
        BSpline.design_matrix(np.clip((w - low) / (high - low), 0, 1 - 1e-9), knots, 3).toarray() for w in (z, among)
    )
    return np.asarray(basis[:, 1:] - all_[:, 1:].mean(0))


def all_columns(path: Path, effects: Iterable[Effect], among: Mapping[str, Array] | None = None) -> list[Columns]:
    """Every candidate along one record, in the same order along each; ``among``: see generic_features."""
    chosen = [e for e in effects if path.model.accepts(e) and _has_inputs(path, e)]
    specific = [c for e in chosen for c in path.effect(e)]
    # the same regressors under a name of their own
    named = {"N(psi)"} if "heading-moment" in {e.name for e in [*chosen, *path.model.effects]} else set()
    return specific + [c for c in path.generic(among) if c.name not in named]


def _has_inputs(path: Path, effect: Effect) -> bool:
    return all(i.name in path.record.inputs for i in effect.inputs)
