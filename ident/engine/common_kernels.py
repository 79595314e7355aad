"""Kernels that several models share: the kernel of a larger model, in which the further effects change nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from seatrial.ident.model import Model


@dataclass(frozen=True)
class LargerModel:
    """Model whose kernels also serve the models that it contains.

    Attributes
    ----------
    model : Model
        The model.
    null : frozenset[str]
        Names of those of its effects that change nothing at the parameter values of the model. Only these may be
        missing in a model that it contains.
    """

    model: Model
    null: frozenset[str]

    def contains(self, model: Model) -> bool:
        """Return whether a model is the larger one without some of the effects that change nothing.

        These effects have no states. The effects of the model have to be in the same order as in the larger one. An
        effect is the same if it has the same name and its hooks are the same object. A model contains itself.
        """
        own = self.model
        if (own.stages, own.second_order) != (model.stages, model.second_order):
            return False
        if (own.states, own.sensors) != (model.states, model.sensors) or not {*model.inputs} <= {*own.inputs}:
            return False
        present = {e.name for e in model.effects}
        if any(e.name not in present | self.null for e in own.effects):
            return False
        effects = iter(own.effects)
        return all(any(e.name == f.name and e.hooks is f.hooks for f in effects) for e in model.effects)


_larger: list[list[LargerModel]] = []  # models of all `common_kernels` contexts that are entered, the last at the end


@contextmanager
def common_kernels() -> Iterator[list[LargerModel]]:
    """Context in which models use the compiled functions of larger models that contain them, in all threads.

    A search fits many models once, each with another effect added to the same model. It takes longer to compile their
    kernels than to run them. The kernel of one model with all of these effects serves all fits: the effects that a fit
    lacks keep the parameter values at which they change nothing.

    At the end of a context inside another one, its models pass to the outer context. Evaluations after a search then
    use the kernels of the search.

    Yields
    ------
    list[LargerModel]
        The larger models, at first none. The caller appends to the list.
    """
    outer = _larger[-1] if _larger else None
    models: list[LargerModel] = []
    _larger.append(models)
    try:
        yield models
    finally:
        _larger[:] = [m for m in _larger if m is not models]
        if outer is not None:
            outer += models


def common_model_of(model: Model) -> Model | None:
    """Return the larger model that contains the model; None without one.

    If several larger models contain it, the one that was appended last is returned.
    """
    known = (larger for models in reversed(_larger) for larger in reversed(models))
    return next((larger.model for larger in known if larger.contains(model)), None)
