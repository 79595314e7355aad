"""Prior knowledge in a model: rig geometry, results of a thruster's bench test, and values that the user gives."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from seatrial.daq.errors import SeatrialError, closest_name
from seatrial.daq.rig import Rig
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation.model_file import SavedModel, load_model
from seatrial.ident.estimation.thrust_scale import AHEAD
from seatrial.ident.model import Effect, EffectPrior, Model, ModelKind, Parameter, ParameterOrigin
from seatrial.ident.models import (
    CURRENT_WALK,
    SIDES,
    TELEMETRY_AGE,
    antenna_component,
    current_walk,
    effect_for,
    telemetry_age,
)

GNSS = {"x", "y", "vx", "vy"}
WEIGHED = ("mass", "m", "weight")  # names by which users mean the weighed mass
ARMS = ("y_left", "y_right", "y_arm")  # positions of the thrusters to starboard
POSITION = "x_thrusters"  # of both thrusters forward of the centre of gravity [m], in [geometry] or [vehicle]
POSITION_SD_M = 0.05  # standard uncertainty of a position by a tape, if none is given
AT_THRUSTERS = ("x_delta", "x_walk", "x_swing")  # parameters of effects that are the position of the thrusters
ANTENNA_SD = "lever_arm_sd"  # standard uncertainty of the given position of the antenna [m], in each direction
AT_ANTENNA = ("l_x", "l_y", "l_z")  # parameters of effects that are an error of the antenna's given position
LONGEST_ARM_M = 5.0  # m, of a boat of a lab; a larger number is probably in centimetres
SHORTEST_SPAN_M = 0.01  # between the thrusters; with less, no thrust difference turns the boat


def apply_rig_geometry(
    model: Model, rig: Rig | None, vehicle: Mapping[str, float] | None = None
) -> tuple[Model, list[str]]:
    """Return the model with the dimensions of the boat from its rig file.

    The dimensions are the values of the table ``vehicle``, the lateral positions of the thrusters (parameters
    ``y_left`` and ``y_right``) and the lever arm of the antenna, of the rig or in ``vehicle``. A value in ``vehicle``
    takes precedence over the position of the thruster. A value with a standard uncertainty becomes the mean of a prior.
    A value without one is the initial value of a parameter that the model estimates, and fixes any other parameter.
    A thrust ``ahead`` without c1 is the first value of c1: `scaled_to_ahead` follows after a fit.
    ``x_thrusters``, or the position of the thrusters in the rig file, is the prior of this position in effects that
    have one (`with_effect_priors`). Other values that are no parameter of the model are ignored.

    Parameters
    ----------
    model
        Model to which the dimensions are applied.
    rig
        Rig file; None if there is none.
    vehicle
        Values by parameter, in the parameters' units; by default those of the rig. ``NAME_sd`` is the standard
        uncertainty of NAME.

    Returns
    -------
    model
        Model with the dimensions.
    notes
        Sentences for the reader about a lever arm that the model cannot use, or about several antennas.

    Raises
    ------
    SeatrialError
        If a value is outside the bounds of its parameter, or not positive where it must be.
    """
    given, known = dict(vehicle if vehicle is not None else rig.vehicle if rig else {}), []
    if AHEAD in given and "c1" not in given:
        given |= {key.replace(AHEAD, "c1"): given[key] for key in (AHEAD, f"{AHEAD}_sd") if key in given}
    levers = {f"y_{t.name}": t.position_m[1] for t in (rig.thrusters if rig else ()) if t.name in SIDES}
    for name, value in (levers | given).items():
        if name in model.values:
            p, sd = model.parameter(name), given.get(f"{name}_sd", 0.0)
            origin = ParameterOrigin.PRIOR if sd else ParameterOrigin.GIVEN
            initial = p.free and not sd  # a value without uncertainty is only the start of an estimate
            try:
                known.append(p.at(value) if initial else p.known(value, sd, origin))
            except ValueError as problem:
                raise SeatrialError(
                    f"the rig file or the import map gives {name} = {value:g}: {problem}; correct it there"
                ) from None
    model = with_effect_priors(model.replace_parameters(*known), given, rig)
    if "antenna_x" in given or not rig:
        forward, starboard, down = (given.get(f"antenna_{axis}", 0.0) for axis in "xyz")
        return _with_antenna(model, [(forward, starboard, down)], "import map")
    return _with_antenna(model, [d.lever_arm_m for d in rig.devices], "rig")


def with_effect_priors(model: Model, vehicle: Mapping[str, float], rig: Rig | None = None) -> Model:
    """Return the model with the priors of effects that the numbers of the boat give.

    The position of the thrusters, ``x_thrusters`` with the standard uncertainty ``x_thrusters_sd`` (0.05 m by default),
    becomes the prior of the parameters `AT_THRUSTERS` of effects that are added later. Without it, the first number of
    ``position_m`` of the thrusters in the rig file takes its place, if it is the same for all of them and not zero.
    The standard uncertainty of the antenna's position, ``lever_arm_sd``, is the prior of its error (`AT_ANTENNA`).
    SeatrialError is raised for an uncertainty that is not positive.
    """
    mean, source = vehicle.get(POSITION), POSITION
    if mean is None:
        mean, source = _position_in_rig(rig), "position_m of the thrusters in the rig file"
    sds = {f"{POSITION}_sd": vehicle.get(f"{POSITION}_sd", POSITION_SD_M), ANTENNA_SD: vehicle.get(ANTENNA_SD, 1.0)}
    for name, sd in sds.items():
        if sd <= 0.0:
            raise SeatrialError(
                f"the rig file or the import map gives {name} = {sd:g}: a standard uncertainty must be positive; "
                "correct it there"
            )
    found = [EffectPrior(n, mean, sds[f"{POSITION}_sd"], source) for n in AT_THRUSTERS] if mean is not None else []
    if ANTENNA_SD in vehicle:
        found += [EffectPrior(n, 0.0, vehicle[ANTENNA_SD], ANTENNA_SD) for n in AT_ANTENNA]
    return replace(model, effect_priors=tuple(found)) if found else model


def _position_in_rig(rig: Rig | None) -> float | None:
    """Return the common position of the thrusters `SIDES` forward of the origin [m], from the rig file.

    None without a rig, if the thrusters have different positions, or if the position is zero: a rig file that was made
    from the tables of an autopilot has zero in place of an unknown position.
    """
    found = {t.position_m[0] for t in (rig.thrusters if rig else ()) if t.name in SIDES}
    return found.pop() or None if len(found) == 1 else None


def _with_antenna(
    model: Model, positions: Sequence[tuple[float, float, float]], source: str
) -> tuple[Model, list[str]]:
    """Return the model with the lever arm of the antenna, and a note if this is not possible or ambiguous.

    The lever arm is the position of the antenna from the centre of gravity: forward, starboard, down [m]. ``positions``
    has that of each device of the ``source``, a rig or an import map. The first device with a lever arm counts as the
    antenna of all GNSS outputs. Further devices with the same lever arm give no note. The model is unchanged, and there
    is no note, if no device has a lever arm other than zero or the model has no GNSS output. The height of an antenna
    does not count for a boat model of the horizontal plane (surge, sway and yaw).
    """
    sensitive = slice(2 if "hull" in model.provides else 3)  # without roll and pitch the height has no effect
    arms = [arm for arm in positions if any(tuple(arm)[sensitive])]
    seen = sorted(GNSS & {o.name for o in model.outputs})
    if not arms or not seen:
        return model, []
    where = ", ".join(f"{a:g} m {way}" for a, way in zip(arms[0], ("ahead", "to starboard", "down"), strict=True))
    part = antenna_component(model, arms[0])
    if not model.accepts(part):
        return model, [
            f"model {model.name} cannot include the lever arm of the {source}'s antenna ({where}): "
            f"it takes {', '.join(seen)} as measured at the origin; use a horizontal or kinematic model if the boat "
            "turns"
        ]
    note = f"the rig has {len(arms)} antennas; model {model.name} uses the first of them ({where}) for all GNSS"
    return model + part, [note] if len(set(arms)) > 1 else []


def with_effects(model: Model, names: Sequence[str], own: Mapping[str, Effect] | None = None) -> Model:
    """Return the model with the effects of these names added (option ``--effect``).

    Some effects have several forms, of which a model accepts one; that form is added. Priors are scaled to the size of
    the boat, or are those that its numbers give (`with_effect_priors`). Free parameters with the value zero start at
    their characteristic step instead: at zero the likelihood of some effects has no slope.

    ``own`` are user-defined effects by name (option ``--effects``). They take precedence over those of the catalogue,
    and their priors are not scaled. If ``names`` has none of them, all are added.

    Raises
    ------
    SeatrialError
        If there is no such effect, or if the model has it already or cannot have it.
    """
    own = own or {}
    for name in chosen_effects(names, own):
        effect = _effect_form_for_model(model, name, own)
        if name not in own:
            effect = effect_for(model, effect)
        model = model + replace(effect, parameters=tuple(_moved_from_zero(p) for p in effect.parameters))
    return model


def chosen_effects(names: Sequence[str], own: Mapping[str, Effect]) -> tuple[str, ...]:
    """Return the names of the effects of ``--effect``; user-defined effects come first if none of them is chosen.

    ``own`` are the user-defined effects of ``--effects``, by name. All of them are then chosen.
    """
    if any(isinstance(name, str) and name in own for name in names):
        return tuple(names)
    return (*own, *names)


def parameters_of_effects(
    model: Model, names: Sequence[str], own: Mapping[str, Effect] | None = None
) -> tuple[str, ...]:
    """Return the names of the parameters of the effects that `with_effects` has added, in the model with them.

    The effect of a model may be another form of the effect of this name; both have the same first parameter.
    """
    own = own or {}
    known = {**_effects_by_name(), **own}
    sizes = {known[name].parameters[0].name for name in chosen_effects(names, own)}
    return tuple(p.name for e in model.effects if sizes & {q.name for q in e.parameters[:1]} for p in e.parameters)


def _effects_by_name() -> dict[str, Effect]:
    """Return the effects that ``--effect`` accepts, by name: those of the catalogue and two of special use."""
    return {**catalogue(), CURRENT_WALK: current_walk(), TELEMETRY_AGE: telemetry_age()}


def _moved_from_zero(p: Parameter) -> Parameter:
    """Return the parameter with its characteristic step as initial value, but at most its upper bound.

    At zero the likelihood of some effects has no slope. A fixed parameter, or one whose value is not zero, is returned
    unchanged.
    """
    return p.at(min(p.step, p.bounds[1])) if p.free and p.value == 0.0 else p


# Words for an effect that its title lacks, and words of the title in their place
SHORTEST_BEGIN = 3  # characters in which a misspelt name and the name of an effect begin alike
OTHER_WORDS = {
    "deadzone": "dead band",
    "deadband": "dead band",
    "fouled": "thrust mismatch",
    "asymmetry": "thrust mismatch",
    "slosh": "sloshing",
    "rudder": "rudders",
    "magnetometer": "compass",
    "backlash": "dead band",
    "gpslatency": "gnss latency",
    "gpsdelay": "gnss latency",
    "gnssdelay": "gnss latency",
    "crossflow": "cross flow",
    "windage": "wind",
}


def _meant(name: str, possible: Mapping[str, Effect]) -> str:
    """Return a question that suggests effects in place of an unknown name; the question is empty if none is similar.

    A name is similar if it is words of the title of the effect, a misspelling of its name, a part of its title, another
    word for it (`OTHER_WORDS`), or words of its causes. Words of a title count more than a misspelling, unless the name
    begins like the one that is misspelt.
    """
    near = closest_name(name, possible)
    word = name.lower().replace("-", " ").replace("_", " ")
    word = OTHER_WORDS.get(word.replace(" ", ""), word)
    titles, causes = (
        {n: getattr(e, text).lower().replace("-", " ") for n, e in possible.items()} for text in ("title", "causes")
    )
    whole = re.compile(rf"\b{re.escape(word)}\b")
    begins = near is not None and near[:SHORTEST_BEGIN].lower() == name[:SHORTEST_BEGIN].lower()
    in_title = [n for n, title in titles.items() if whole.search(title)]
    if near and (begins or not in_title):
        found = [near]
    else:
        found = in_title or [n for n, t in titles.items() if word in t] or [n for n, t in causes.items() if word in t]
    questions = [f"{n} ({possible[n].title})" for n in found[:3]]
    return f"did you mean {' or '.join(questions)}? " if questions else ""


def _effect_form_for_model(model: Model, name: str | Effect, own: Mapping[str, Effect]) -> Effect:
    """Return the effect with this name, in the form that the model accepts. ``own`` are user-defined effects by name.

    All forms of an effect have the same first parameter, by which they are found. If the model accepts several forms,
    the first one in the catalogue is returned. SeatrialError is raised if the name is a file or an effect itself, if
    there is no such effect, if the model has its first parameter already, or if the model accepts no form.
    """
    known = {**_effects_by_name(), **own}
    possible = {e.name: e for e in known.values() if model.accepts(e)}
    can = ", ".join(possible) or "none"
    if isinstance(name, Effect) or name.endswith(".py"):
        shown = name.name if isinstance(name, Effect) else name
        raise SeatrialError(
            f"--effect {shown}: takes the name of an effect; give the file that defines an effect of your own with "
            "--effects FILE.py, and its name with --effect if the file has several (documentation: Add an effect)"
        )
    if name not in known:
        meant = _meant(name, possible)
        others = "" if meant else f"model {model.name} can have {', '.join(sorted(possible))}"
        raise SeatrialError(f"--effect {name}: there is no such effect; {meant}{others}".rstrip())
    size = known[name].parameters[0].name  # all forms of an effect share their first parameter
    if size in model.values:
        raise SeatrialError(f"--effect {name}: model {model.name} has it already")
    if name in own and model.accepts(own[name]):
        return own[name]
    fitting = [e for e in possible.values() if name == e.name or size == e.parameters[0].name]
    if not fitting:
        raise SeatrialError(f"--effect {name}: model {model.name} has no place for this effect; it can have {can}")
    return fitting[0]


def fix_parameters(
    model: Model, thruster: Path | None, given: Mapping[str, float], *, diagnosed: bool = False
) -> tuple[Model, list[str]]:
    """Return the model with known parameters: thrust from a bench test, and fixed values from the command line.

    The thrust coefficients c1 and c2 from the bench get a prior with their standard uncertainty (statistics and
    calibration). A coefficient that the bench test did not estimate is fixed at its value there. A value in ``given``
    takes precedence over the bench.

    Parameters
    ----------
    model
        Model to which the values are applied.
    thruster
        Model file of a bench test; None if there is none.
    given
        Values to which parameters are fixed, by name and in the parameters' units.
    diagnosed
        Whether effects that the model lacks are searched for. The advice about a parameter of such an effect is then
        another one, since a search has no option ``--effect``.

    Returns
    -------
    model
        Model with these parameters.
    notes
        A sentence about the coefficient c2 if the bench test did not measure it, and one about each thruster that is
        more than 5 m from the middle by any source (option, log or rig).

    Raises
    ------
    SeatrialError
        If the model lacks a parameter of ``given`` or cannot have this value of it, if the given thrust ahead or astern
        is not positive, if both thrusters are at the same place, if the file of the bench test cannot be read or is not
        the model of a thruster, or if it has no thrust coefficient or does not determine it.
    """
    known: dict[str, Parameter] = {}
    notes = []
    if thruster is not None:
        bench = load_model(thruster)
        if bench.model.kind is not ModelKind.BENCH:
            raise SeatrialError(
                f"{thruster}: is the model {bench.model.name} of a boat, not of a thruster; give --thruster the "
                "model.toml of `seatrial ident thruster`"
            )
        for name in ("c1", "c2"):
            if name in model.values and name not in given:
                p = _bench_parameter(bench, name, thruster)
                origin = ParameterOrigin.MEASURED if p.free else p.origin
                known[name] = model.parameter(name).known(p.value, bench.uncertainty(name) if p.free else 0.0, origin)
                if name == "c2" and not p.free:
                    notes.append(
                        f"{thruster} cannot separate c2 from c1, since the shaft turned in one direction only: the "
                        f"reverse thrust is assumed to equal the forward thrust (c2 = {p.value:g} N)"
                    )
    for name, value in given.items():
        if name not in model.values:
            raise _no_parameter(model, "--fix", name, given[name], diagnosed=diagnosed)
        try:
            known[name] = model.parameter(name).known(value, 0.0, ParameterOrigin.GIVEN)
        except ValueError as problem:
            raise SeatrialError(f"--fix {name}={value:g}: {problem}") from None
    model = model.replace_parameters(*known.values())
    _check_thrust(model)
    _check_arms(model)
    for name in ARMS:
        if abs(value := model.values.get(name, 0.0)) > LONGEST_ARM_M:
            notes.append(f"{name} = {value:g} m is a long way from the middle of a boat: is it in centimetres?")
    return model, notes


def _check_thrust(model: Model) -> None:
    """Raise SeatrialError if c2 was given, and the thrust at full speed ahead or astern is then not positive.

    It may be given by any source: option, rig file or import map. A c2 of a bench test is not checked: that thruster
    may have hardly any thrust in one direction.
    """
    if not {"c1", "c2"} <= set(model.values):
        return
    c1, c2 = model.parameter("c1"), model.parameter("c2")
    if c2.origin not in (ParameterOrigin.GIVEN, ParameterOrigin.PRIOR) or abs(c2.value) < c1.value:
        return
    if model.kind is ModelKind.BENCH and c1.free:  # its value is not known before the fit
        return
    mean = f"c1 = {c1.value:g} N{' (built in)' * (c1.origin is ParameterOrigin.BUILT_IN)}"
    if c2.value > 0.0:
        problem = f"is not smaller than {mean}: the thrust astern, c1 - c2, would not be positive"
    else:
        problem = f"and {mean}: the thrust ahead, c1 + c2, would not be positive"
    raise SeatrialError(
        f"c2 = {c2.value:g} N {problem}; correct --fix, --prior, the rig file or [scale] of the import map (c1 is the "
        "mean of the thrust ahead and astern, c2 half their difference)"
    )


def _check_arms(model: Model) -> None:
    """Raise SeatrialError if both thrusters are at the same place, so that no thrust difference can turn the boat."""
    left, right = (model.values.get(f"y_{side}") for side in ("left", "right"))
    if left is None or right is None or abs(left - right) >= SHORTEST_SPAN_M:
        return
    raise SeatrialError(
        f"y_left = {left:g} m and y_right = {right:g} m: both thrusters are at the same place, and cannot turn the "
        "boat; give both positions with --fix, in the rig file or in [geometry] of the import map (positive to "
        "starboard, so that y_left is usually negative)"
    )


def _no_parameter(
    model: Model, option: str, name: str, value: float | None = None, *, diagnosed: bool = False
) -> SeatrialError:
    """Return the error about a name of ``--fix``, ``--prior`` or ``--initial`` that is no parameter of the model.

    It has all names, and the nearest one if there is one. For the mass of the boat it names the option of the weighed
    mass, with its ``value`` [kg]. It names the effect to which the parameter belongs. It says how the value is given to
    a fit, or to a search for missing effects if ``diagnosed``. For the position of a thruster it says that the model
    does not use positions. In a rig file, a position has no effect on such a model.
    """
    text = f"{option} {name}: model {model.name} has no such parameter; it has {', '.join(model.values)}"
    if name in ARMS and not set(ARMS) & set(model.values):
        steering = ", because its steering gain K contains them" * ("K" in model.values)
        text += f"; the model does not use the positions of the thrusters{steering}: leave out {option} {name}"
    elif name in WEIGHED and value is not None and "m_u" in model.values:
        text += f"; the weighed mass is --mass={value:g}; m_u is the mass in surge with the added mass"
    elif effects := [e.name for e in catalogue().values() if name in {p.name for p in e.parameters}]:
        belongs = f"; it is a parameter of the effect {' or '.join(effects)}"
        if diagnosed and name in AT_THRUSTERS:
            text += (
                f"{belongs}, which is not in the model: give {POSITION} and {POSITION}_sd in [geometry] of the import "
                "map, or in [vehicle] of the rig file; they are its prior in the search"
            )
        elif diagnosed:
            text += (
                f"{belongs}, which is not in the model: fit it with `seatrial ident vehicle --effect {effects[0]} "
                f"--fix {name}={value:g}`, and diagnose the model.toml of that fit"
            )
        else:
            text += (
                f"{belongs}: add --effect {effects[0]}, and --no-score-tests to fit no other effects than those of "
                "--effect"
            )
    elif near := closest_name(name, model.values):
        text += f"; did you mean {near!r}?"
    return SeatrialError(text)


def _bench_parameter(bench: SavedModel, name: str, path: Path) -> Parameter:
    """Return the thrust coefficient ``name`` of a bench test's model, which was read from ``path``.

    The file is not read again; the path is for the messages. A coefficient that is fixed in the model is returned as it
    is. SeatrialError is raised if the model lacks the coefficient, or if it is free but has no standard error.
    """
    if name not in bench.model.values:
        raise SeatrialError(
            f"{path}: the bench model has no {name}; give a model that was fitted to logs with a load cell"
        )
    p = bench.model.parameter(name)
    if p.free and not bench.uncertainty(name) > 0.0:
        raise SeatrialError(
            f"{path}: {name} = {p.value:.4g} N has no standard error: its logs do not determine it; add forward and "
            f"reverse steps on the bench, or give --fix {name}=..."
        )
    return p


def set_priors(model: Model, prior: Mapping[str, tuple[float, float]]) -> Model:
    """Return the model with priors, given as (mean, standard deviation) by parameter in the parameters' units.

    The parameters become free, and their estimates start at the means. A considered parameter stays considered, and a
    standard deviation of 0 fixes the parameter to the mean.

    Raises
    ------
    SeatrialError
        If there is no such parameter, or if a prior is not valid for it.
    """
    given = []
    for name, (mean, sd) in prior.items():
        if name not in model.values:
            raise _no_parameter(model, "--prior", name, mean)
        try:
            given.append(model.parameter(name).known(mean, sd, ParameterOrigin.PRIOR))
        except ValueError as problem:
            raise SeatrialError(f"--prior {name}={mean:g}:{sd:g}: {problem}") from None
    return model.replace_parameters(*given)


def with_values_per_log(model: Model, names: Iterable[str]) -> Model:
    """Return the model in which these parameters of added effects have a value of their own in each log.

    SeatrialError is raised for a name that is no estimated parameter of an effect that was added to the model.
    """
    own = {p.name: e for e in model.effects if not e.kind.nuisance for p in e.parameters}
    for name in names:
        if name not in model.values:
            raise _no_parameter(model, "--per-log", name)
        parameter = model.parameter(name)
        if name not in own or not parameter.free:
            possible = ", ".join(n for n in own if model.parameter(n).free) or "none; add an effect with --effect"
            raise SeatrialError(
                f"--per-log {name}: only estimated parameters of effects can have a value for each log, here: "
                f"{possible}. Whether the logs agree on another parameter is a question for --test-homogeneity"
            )
        model = model.replace_parameters(replace(parameter, per_record=True))
    return model


def set_initial_values(model: Model, initial: Mapping[str, float]) -> Model:
    """Return the model with other initial values, given by parameter in the parameters' units.

    SeatrialError is raised if the model lacks one of the parameters, or if a value is outside its bounds or not
    positive where it must be.
    """
    unknown = set(initial) - set(model.values)
    if unknown:
        first = sorted(unknown)[0]
        raise _no_parameter(model, "--initial", first, initial[first])
    for name, value in initial.items():
        try:
            model = model.with_values({name: value})
        except ValueError as problem:
            raise SeatrialError(f"--initial {name}={value:g}: {problem}") from None
    return model
