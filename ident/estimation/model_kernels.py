"""Compiled filter functions for a model: its own, or those of a larger model that contains it.

``seatrial.ident.engine.common_kernels`` is the context in which models share the functions of larger ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.engine import FilterKernels, Kernel, common_model_of, filter_kernels_for
from seatrial.ident.estimation.prepared_record import Prepared
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array


@dataclass(frozen=True)
class ModelKernels:
    """Compiled filter functions for a model, which may be those of a larger model that contains it.

    Attributes
    ----------
    kernels : FilterKernels
        Compiled filter functions of the larger model.
    without : Array (n_larger,)
        Values of its parameters at which its further effects change nothing.
    place : Array (n_parameters,) of int
        Index, in the larger model, of each parameter of the model.
    inputs : Array (n_inputs,) of int, optional
        Index, in the larger model, of each input of the model. None if both have the same inputs.
    n_inputs : int
        Number of inputs of the larger model.
    """

    kernels: FilterKernels
    without: Array
    place: NDArray[np.intp]
    inputs: NDArray[np.intp] | None = None
    n_inputs: int = 0

    def arrays(self, kernel: Kernel, data: Prepared, values: Array, piece: slice = slice(None)) -> dict[str, Array]:
        """Return the arrays that a compiled function reads, by name: parameters, and the rows of a prepared record.

        Parameters
        ----------
        kernel
            Function of `kernels`.
        data
            Record for the model.
        values : Array (n_parameters,)
            Values of all parameters of the model. The further parameters of the larger model change nothing.
        piece
            Slice of rows; by default all rows. Inputs that the model lacks are zero: without their effects, they
            change nothing.
        """
        p = self.without.copy()
        p[self.place] = values
        arrays = kernel_inputs(kernel, data, piece)
        if self.inputs is not None:
            for name in arrays.keys() & {"u", "u_next"}:
                wide = np.zeros((len(arrays[name]), self.n_inputs))
                wide[:, self.inputs] = arrays[name]
                arrays[name] = wide
        return arrays | {"p": p}


def kernel_inputs(kernel: Kernel, data: Prepared, piece: slice = slice(None)) -> dict[str, Array]:
    """Return those arrays of a prepared record that a compiled function reads, by name, cut to a slice of rows.

    ``piece`` is the slice; by default it holds all rows.
    """
    return {name: a[piece] for name, a in data.rows.items() if name in kernel.layout.sizes}


def model_kernels(model: Model, *, covariance: bool = True, joseph: bool = False) -> ModelKernels:
    """Return the compiled filter functions for a model, with the options of `filter_kernels_for`.

    They are its own, if the main one is in memory already or if no larger model contains it (`common_model_of`).
    """
    own = filter_kernels_for(model, covariance=covariance, joseph=joseph)
    larger = None if own.has("tangent" if covariance else "simulate") else common_model_of(model)
    if larger is None:
        n = len(model.parameters)
        return ModelKernels(own, np.zeros(n), np.arange(n))
    kernels = filter_kernels_for(larger, covariance=covariance, joseph=joseph)
    place = {p.name: k for k, p in enumerate(larger.parameters)}
    column = {i.name: k for k, i in enumerate(larger.inputs)}
    return ModelKernels(
        kernels,
        np.array([p.value for p in larger.parameters]),
        np.array([place[p.name] for p in model.parameters], dtype=np.intp),
        np.array([column[i.name] for i in model.inputs], dtype=np.intp) if len(column) > len(model.inputs) else None,
        len(column),
    )
