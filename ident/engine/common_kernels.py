"""Kernels that several models share: the kernel of a larger model, in which the further effects change nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from seatrial.ident.model import Model

_larger: list[list[Model]] = []  # models of all `common_kernels` contexts that are entered, the last one at the end


@contextmanager
def common_kernels() -> Iterator[list[Model]]:
    """Context in which models use the compiled sensitivities of larger models that contain them, in all threads.

    A search fits many models once, each with another effect added to the same model. It takes longer to compile their
    kernels than to run them. The kernel of one model with all of these effects serves all fits: the effects that a fit
    lacks keep the parameter values at which they change nothing.

    Yields
    ------
    list[Model]
        The larger models, at first none. The caller appends to the list.
    """
    models: list[Model] = []
    _larger.append(models)
    try:
        yield models
    finally:
        _larger[:] = [m for m in _larger if m is not models]


def common_model_of(model: Model) -> Model | None:
    """Return the larger model, appended last, that contains the model (`contains`). None if there is none."""
    known = (larger for models in reversed(_larger) for larger in reversed(models))
    return next((larger for larger in known if contains(larger, model)), None)


def contains(larger: Model, model: Model) -> bool:
    """Return whether a model is the larger one without some of its effects, where these effects have no states.

    The effects of the model have to be in the same order as in the larger one. An effect is the same if it has the same
    name and its hooks are the same object. A model contains itself.
    """
    if (larger.stages, larger.second_order) != (model.stages, model.second_order):
        return False
    if (larger.states, larger.sensors) != (model.states, model.sensors) or not {*model.inputs} <= {*larger.inputs}:
        return False
    effects = iter(larger.effects)
    return all(any(e.name == f.name and e.hooks is f.hooks for f in effects) for e in model.effects)
