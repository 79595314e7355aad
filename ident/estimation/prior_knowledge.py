"""Prior knowledge: rig geometry, bench characterisation, and values that the user gave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from seatrial.daq.errors import SeatrialError
from seatrial.daq.rig import Rig
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation.model_file import SavedModel, load_model
from seatrial.ident.model import Effect, Model, Parameter, ParameterOrigin
from seatrial.ident.models import (
    CURRENT_WALK,
    SIDES,
    TELEMETRY_AGE,
    antenna_component,
    current_walk,
    scale_priors,
    size_of,
    telemetry_age,
)

GNSS = {"x", "y", "vx", "vy"}


def apply_rig_geometry(
    model: Model, rig: Rig | None, vehicle: Mapping[str, float] | None = None
) -> tuple[Model, list[str]]:
    """The model with what the rig file says of the boat, and a line for each thing that it cannot take into account.
    ``vehicle``: what is known of the boat, by default the rig's; ``NAME_sd`` is the standard uncertainty of NAME."""
    given, known = dict(vehicle if vehicle is not None else rig.vehicle if rig else {}), []
    levers = {f"y_{t.name}": t.position_m[1] for t in (rig.thrusters if rig else ()) if t.name in SIDES}
    for name, value in (levers | given).items():
        if name in model.values:
            p, sd = model.parameter(name), given.get(f"{name}_sd", 0.0)
            origin = ParameterOrigin.PRIOR if sd else ParameterOrigin.GIVEN
            starts = p.free and not sd  # an estimate begins there; what is not estimated is known
            known.append(p.at(value) if starts else p.known(value, sd, origin))
    model = model.replace_parameters(*known)
    return _with_antenna(model, rig) if rig else (model, [])


def _with_antenna(model: Model, rig: Rig) -> tuple[Model, list[str]]:
    felt = slice(2 if "hull" in model.provides else 3)  # a level boat does not feel the height
    arms = [d.lever_arm_m for d in rig.devices if any(tuple(d.lever_arm_m)[felt])]
    seen = sorted(GNSS & {o.name for o in model.outputs})
    if not arms or not seen:
        return model, []
    where = ", ".join(f"{a:g} m {way}" for a, way in zip(arms[0], ("ahead", "to starboard", "down"), strict=True))
    part = antenna_component(model, arms[0])
    if not model.accepts(part):
        return model, [
            f"the rig's antenna ({where}) is not in model {model.name}, which takes "
            f"{', '.join(seen)} as that of the origin"
        ]
    first = f"the rig places {len(arms)} antennas; model {model.name} takes the first of them ({where}) for all GNSS"
    return model + part, [first] if len(set(arms)) > 1 else []


def with_effects(model: Model, names: Sequence[str]) -> Model:
    """The model with effects by name, their parameters free; one that has another form for this model takes that.

    They start a step that matters from doing nothing, where the likelihood of some has no slope.
    """
    for name in names:
        effect = scale_priors(_effect_for(model, name), size_of(model))
        model = model + replace(effect, parameters=tuple(_begun(p) for p in effect.parameters))
    return model


def _begun(p: Parameter) -> Parameter:
    return p.at(min(p.step, p.bounds[1])) if p.free and p.value == 0.0 else p


def _effect_for(model: Model, name: str) -> Effect:
    known = {**catalogue(), CURRENT_WALK: current_walk(), TELEMETRY_AGE: telemetry_age()}
    possible = {e.name: e for e in known.values() if model.accepts(e)}
    can = ", ".join(possible) or "none"
    if name not in known:
        raise SeatrialError(f"--effect {name}: model {model.name} knows no such effect; it can have {can}")
    size = known[name].parameters[0].name  # which another form of the effect has too
    if size in model.values:
        raise SeatrialError(f"--effect {name}: model {model.name} has it already")
    fitting = [e for e in possible.values() if name == e.name or size == e.parameters[0].name]
    if not fitting:
        raise SeatrialError(f"--effect {name}: model {model.name} cannot take it into account; it can have {can}")
    return fitting[0]


def fix_parameters(model: Model, thruster: Path | None, given: Mapping[str, float]) -> tuple[Model, list[str]]:
    """Parameters that are known: from the bench with their standard uncertainty (statistics and calibration), and fixed
    ones from the command line; and a line for what the bench did not measure. Raises SeatrialError where there is no
    such parameter, or the bench's logs did not tell it."""
    known: dict[str, Parameter] = {}
    notes = []
    if thruster is not None:
        bench = load_model(thruster)
        for name in ("c1", "c2"):
            if name in model.values and name not in given:
                p = _of_bench(bench, name, thruster)
                origin = ParameterOrigin.MEASURED if p.free else p.origin
                known[name] = model.parameter(name).known(p.value, bench.uncertainty(name) if p.free else 0.0, origin)
                if name == "c2" and not p.free:
                    notes.append(
                        f"{thruster} does not tell c2 from c1, since the shaft turned one way: the thrust "
                        f"astern is taken for as large as ahead (c2 = {p.value:g} N)"
                    )
    for name, value in given.items():
        if name not in model.values:
            raise SeatrialError(
                f"--fix {name}: model {model.name} has no such parameter; it has {', '.join(model.values)}"
            )
        known[name] = model.parameter(name).known(value, 0.0, ParameterOrigin.GIVEN)
    return model.replace_parameters(*known.values()), notes


def _of_bench(bench: SavedModel, name: str, path: Path) -> Parameter:
    """A thrust coefficient as the bench told it."""
    if name not in bench.model.values:
        raise SeatrialError(f"{path}: has no {name}: a model with a load cell's force is needed")
    p = bench.model.parameter(name)
    if p.free and not bench.uncertainty(name) > 0.0:
        raise SeatrialError(
            f"{path}: {name} = {p.value:.4g} N has no standard error: its logs did not tell it; add steps ahead and "
            f"astern on the bench, or give --fix {name}=..."
        )
    return p


def set_priors(model: Model, prior: Mapping[str, tuple[float, float]]) -> Model:
    """The model with means and standard deviations that are known before; the estimate starts from the means."""
    given = []
    for name, (mean, sd) in prior.items():
        if name not in model.values:
            raise SeatrialError(f"--prior {name}: model {model.name} has {', '.join(model.values)}")
        try:
            given.append(model.parameter(name).known(mean, sd, ParameterOrigin.PRIOR))
        except ValueError as problem:
            raise SeatrialError(f"--prior {name}={mean:g}:{sd:g}: {problem}") from problem
    return model.replace_parameters(*given)


def set_initial_values(model: Model, begin: Mapping[str, float]) -> Model:
    unknown = set(begin) - set(model.values)
    if unknown:
        raise SeatrialError(f"--initial {sorted(unknown)[0]}: model {model.name} has {', '.join(model.values)}")
    return model.with_values(begin)
