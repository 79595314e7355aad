"""Differences between two fitted models: structure, effects, parameters, inputs, priors, logs and method of the fit."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from seatrial.ident.estimation import SavedModel
from seatrial.ident.model import Model, Parameter, ParameterOrigin
from seatrial.ident.results import DifferenceKind, ModelDifference


def model_differences(reference: SavedModel, other: SavedModel) -> tuple[ModelDifference, ...]:
    """Return what two saved models differ in, apart from the values of their estimates.

    The kinds are in a fixed order. A kind without a difference is left out, so that the result is empty for two models
    that differ only in their estimates.

    Parameters
    ----------
    reference, other
        The models. The reference is the first model of the comparison.
    """
    described = [_description(saved) for saved in (reference, other)]
    found = []
    for kind, of_reference in described[0].items():
        of_other = described[1][kind]
        own = tuple(text for text in of_other if text not in of_reference)
        lacking = tuple(text for text in of_reference if text not in of_other)
        if own or lacking:
            found.append(ModelDifference(kind=kind, here=own, in_reference=lacking))
    return tuple(found)


def _description(saved: SavedModel) -> dict[DifferenceKind, tuple[str, ...]]:
    """Return the properties of a model as texts by kind. Equal texts of two models are equal properties."""
    model = saved.model
    return {
        "structure": (_structure_name(model),),
        "effects": tuple(e.name for e in model.effects),
        "inputs": _distinct(x.tap_of or x.name for x in model.inputs),
        "channels": _measured_channels(saved),
        "estimated": tuple(p.name for p in model.parameters if p.free),
        "fixed": tuple(_value_text(p) for p in model.parameters if not p.free),
        "priors": tuple(text for p in model.parameters if (text := _prior_text(p))),
        "logs": _distinct(_log_name(str(line)) for line in saved.provenance.get("logs", ())),
        "method": ("REML" if saved.reml else "maximum likelihood", f"filter of order {1 + model.second_order}"),
    }


def _measured_channels(saved: SavedModel) -> tuple[str, ...]:
    """Return the names of the outputs that the sensors of the fitted data measured.

    A user-defined model keeps its sensors without data, but model.toml has no rate for them. If it has no rates at all,
    all outputs are returned.
    """
    sensors = [s for s in saved.model.sensors if not saved.rates or s.name in saved.rates]
    return tuple(o.name for s in sensors for o in s.outputs)


def _structure_name(model: Model) -> str:
    """Return the name of the structure of a model, such as ``horizontal:shaft``, or its name without a source."""
    return model.source or model.name


def _value_text(p: Parameter) -> str:
    """Return the name, the value and the unit of a fixed parameter as text, such as ``c1 = 40 N``."""
    return f"{p.name} = {p.value:.6g} {p.unit}".rstrip()


def _prior_text(p: Parameter) -> str:
    """Return a prior for this boat as text, such as ``c1 = 40 ± 2 N``; empty without a prior that informs an estimate.

    The prior of a considered parameter counts, because the standard errors contain it. Priors that are part of the
    model do not count: they belong to its effects, which are listed, and follow from the estimated size of the boat.
    """
    if p.prior is None or p.exact or p.origin is ParameterOrigin.BUILT_IN:
        return ""
    mean, sd = p.prior
    return f"{p.name} = {mean:.4g} ± {sd:.2g} {p.unit}".rstrip()


def _log_name(line: str) -> str:
    """Return the file name of a log from a line of the provenance, ``PATH sha256:HASH``.

    The beginning of the hash is kept, because logs of different folders may have equal names.
    """
    path, _, digest = line.partition(" sha256:")
    return f"{Path(path).name} ({digest[:6]})" if digest else Path(path).name


def _distinct(texts: Iterable[str]) -> tuple[str, ...]:
    """Return the texts without repetitions, in their order."""
    return tuple(dict.fromkeys(texts))
