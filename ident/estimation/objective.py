"""Objective of a fit: log-likelihood and log-prior over the free coordinates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ident.data import Record
from ident.estimation.fisher_scoring import Bounds, Evaluation
from ident.estimation.likelihood import Likelihood
from ident.numerics import Array

T = TypeVar("T")


class Problem:
    """Of the ``free`` parameters; ``begin``: values of ``V_x@0`` and the like to start from, not the model's own."""

    def __init__(self, likelihood: Likelihood, records: Sequence[Record], free: Sequence[str], threads: int,
                 begin: Mapping[str, float] | None = None) -> None:
        self.likelihood, self.records, self.begin = likelihood, tuple(records), begin or {}
        model = self.model = likelihood.model
        index = {p.name: i for i, p in enumerate(model.parameters)}
        shared = [n for n in free if not model.parameter(n).per_record]
        own = [n for n in free if model.parameter(n).per_record]
        self.free = (*shared, *own)
        copies = [replace(model.parameter(n), segment=i) for i in range(len(records)) for n in own]
        self.parameters = (*(model.parameter(n) for n in shared), *copies)
        self.names = tuple(p.full_name for p in self.parameters)
        self.columns = [index[p.name] for p in self.parameters]
        # places[i]: where record i's free parameters stand among the coordinates
        first = len(shared)
        self.places = [[*range(first), *range(first + i * len(own), first + (i + 1) * len(own))]
                       for i in range(len(records))]
        self.base = np.array([p.value for p in model.parameters])
        self.threads = max(1, min(threads, len(records)))

    @cached_property
    def bounds(self) -> Bounds:
        low, high = np.array([p.free_bounds() for p in self.parameters]).reshape(-1, 2).T
        return Bounds(low, high, np.array([p.transform == "log" for p in self.parameters], dtype=bool))

    @property
    def start(self) -> Array:
        own = zip(self.names, self.parameters, strict=True)
        return np.array([p.to_free(self.begin.get(name, p.value)) for name, p in own])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean and information of each coordinate's prior; no prior has no information."""
        given = [p.free_prior() for p in self.parameters]
        mean = np.array([g[0] if g else 0.0 for g in given])
        return mean, np.array([1.0 / g[1] ** 2 if g else 0.0 for g in given])

    def values(self, z: Array) -> Array:
        """(n_records, n_parameters) in own units."""
        own = self.own(z)
        out = np.tile(self.base, (len(self.records), 1))
        for i, places in enumerate(self.places):
            out[i, [self.columns[k] for k in places]] = own[places]
        return out

    def own(self, z: Array) -> Array:
        """The coordinates' values in own units (n,); the bounds once more, for the rounding of logarithms."""
        return np.array([np.clip(p.from_free(float(c)), *p.bounds) for p, c in zip(self.parameters, z, strict=True)])

    def slopes(self, z: Array) -> Array:
        """d value / d coordinate."""
        return np.array([p.slope(p.from_free(float(c))) for p, c in zip(self.parameters, z, strict=True)])

    def evaluate(self, z: Array) -> Evaluation:
        """Log-posterior, gradient and information with the priors', by the coordinates."""
        mean, weight = self.prior
        value = 0.0
        gradient, information = np.zeros(z.size), np.zeros((z.size, z.size))
        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, self.free), z)
        slope = self.slopes(z)
        for places, scores in zip(self.places, rows, strict=True):
            value += scores.value
            gradient[places] += slope[places] * scores.gradient
            information[np.ix_(places, places)] += np.outer(slope[places], slope[places]) * scores.information
        # A logarithm of a standard deviation s that goes to zero: ln L ~ -c s^2, whose second derivative is twice
        # its first, while the expected information is of the order s^4 and would let the prior overshoot.
        twice = np.where(self.bounds.logarithmic, 2.0 * np.maximum(-gradient, 0.0), 0.0)
        curvature = np.maximum(twice - np.diag(information), 0.0)
        value -= 0.5 * float(weight @ (z - mean) ** 2)
        return Evaluation(value, gradient - weight * (z - mean), information + np.diag(weight), curvature)

    def information(self, z: Array, which: NDArray[np.intp]) -> Array:
        """Of some of the coordinates alone, with their priors' (n_which, n_which): less work than all of it."""
        slope, wanted, n = self.slopes(z), set(which.tolist()), len(self.free)
        total = np.diag(self.prior[1])

        def chosen(i: int) -> list[int]:
            return [k for k in range(n) if self.places[i][k] in wanted]

        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, [self.free[k] for k in chosen(i)]), z)
        for i, scores in enumerate(rows):
            at = [self.places[i][k] for k in chosen(i)]
            total[np.ix_(at, at)] += np.outer(slope[at], slope[at]) * scores.information
        return total[np.ix_(which, which)]

    def value_and_gradient(self, z: Array) -> tuple[float, Array]:
        """Log-posterior and gradient by the adjoint."""
        mean, weight = self.prior
        value, gradient = -0.5 * float(weight @ (z - mean) ** 2), -weight * (z - mean)
        slope = self.slopes(z)
        rows = self._map(lambda i, v: self.likelihood.gradient(self.records[i], v), z)
        for places, (ll, by_parameter) in zip(self.places, rows, strict=True):
            value += ll
            gradient[places] += slope[places] * by_parameter[[self.columns[k] for k in places]]
        return value, gradient

    def by_row(self, z: Array) -> list[tuple[list[int], Array]]:
        """For each record: its coordinates, and what each row adds to the gradient."""
        slope = self.slopes(z)
        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, self.free, by_row=True), z)
        return [(places, slope[places] * scores.by_row) for places, scores in zip(self.places, rows, strict=True)
                if scores.by_row is not None]

    def check(self, z: Array) -> None:
        """Raise ValueError naming the first record that cannot be evaluated."""
        for record, values in zip(self.records, self.values(z), strict=True):
            if not np.isfinite(self.likelihood.value(record, values)):
                raise ValueError(f"record {record.name}: the likelihood of model {self.model.name} cannot be "
                                 "evaluated at the starting values")

    def _map(self, work: Callable[[int, Array], T], z: Array) -> list[T]:
        values = self.values(z)
        if self.threads == 1:
            return [work(i, v) for i, v in enumerate(values)]
        with ThreadPoolExecutor(self.threads) as pool:  # the kernels leave Python's lock
            return list(pool.map(work, range(len(values)), values))
