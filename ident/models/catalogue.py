"""Catalogue of model structures, one module each, and the construction of a model by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from seatrial.daq.errors import SeatrialError
from seatrial.daq.plugins import load_plugin, plugins
from seatrial.ident.model import Effect, Model
from seatrial.ident.models.components import current_walk
from seatrial.ident.models.user_code import check_user_model, load_object

BUILT_IN = ("horizontal", "nomoto", "kinematic", "surge", "yaw", "thruster")
GROUP = "seatrial.models"  # entry points by which other packages add models
# Options after the name, by position: surge:shaft:speed, yaw:both
OPTIONS: dict[str, tuple[tuple[str, ...], ...]] = {
    "surge": (("force", "shaft"), ("position", "speed", "both")),
    "yaw": (("rate", "both"),),
    "thruster": (("slow",),),
}


# Signals of the built-in models, with their units; docs/formats/import.md has the same list
KNOWN_SIGNALS = {
    "x": "m",
    "y": "m",
    "psi": "rad",
    "r": "rad/s",
    "ax": "m/s2",
    "ay": "m/s2",
    "vx": "m/s",
    "vy": "m/s",
    "u": "m/s",
    "v": "m/s",
    "phi": "rad",
    "theta": "rad",
    "p": "rad/s",
    "q": "rad/s",
    "n_left": "",
    "n_right": "",
    "f_left": "N",
    "f_right": "N",
    "X": "N",
    "N": "N m",
    "n": "",
    "n_cmd_left": "",
    "n_cmd_right": "",
    "force": "N",
    "speed": "m/s",
}


def make_model(source: str, sensors: Sequence[str] | None = None) -> Model:
    """Return a model by name: a model of the catalogue, or a user-defined model, whose file is run.

    Parameters
    ----------
    source : str
        Name in the catalogue with options, or ``FILE.py:NAME``. NAME is a Model or a function that returns a Model.
    sensors : Sequence[str], optional
        Names of the sensors that the log contains. A catalogue model gets only those of its sensors, if it has a choice
        (`catalogue_model` states the exceptions). None: all its usual sensors. It is ignored for a user-defined model.

    Raises
    ------
    SeatrialError
        If there is no such model, or if its file cannot be used.
    """
    return own_model(source) if is_own_model(source) else catalogue_model(source, sensors)


def is_own_model(source: str) -> bool:
    """Return whether the text ``source`` has the form ``FILE.py:NAME`` of a user-defined model.

    The part before the last colon must end with ``.py``; NAME may be empty. A path without a colon gives False. The
    file is not read and need not exist.
    """
    return source.rpartition(":")[0].endswith(".py")


def catalogue_model(source: str, sensors: Sequence[str] | None = None) -> Model:
    """Return a model of the catalogue, or of another installed package, by name. No Python file of the user is run.

    Parameters
    ----------
    source : str
        Name with options, for example ``horizontal:shaft``, ``horizontal:force:no-current``, ``kinematic:shaft:yaw``.
        Options that are left out have the defaults of the model.
    sensors : Sequence[str], optional
        Names of the sensors that the log contains. The models horizontal, nomoto and kinematic get only those of their
        sensors, and the model thruster has a load cell only if ``load_cell`` is among them. None: all usual sensors of
        the model; also if horizontal, nomoto or kinematic would get none otherwise. Other models ignore it.

    Raises
    ------
    SeatrialError
        If there is no such model or option; the message lists the choices. Also if the function of another package
        fails or does not return a Model.
    """
    kind, *options = source.split(":")
    if kind not in BUILT_IN:
        return _model_of_package(source, kind, options)
    if kind == "horizontal":
        return _horizontal_by_options(source, options, sensors)
    if kind == "thruster" and (options in ([], ["slow"]) or _is_delay_step(options)):
        from seatrial.ident.models.thruster import thruster_model

        return thruster_model(*options, force=sensors is None or "load_cell" in sensors)
    if kind == "nomoto":
        return _nomoto_by_options(source, options, sensors)
    if kind == "kinematic":
        return _kinematic_by_options(source, options, sensors)
    module = importlib.import_module(f"seatrial.ident.models.{kind}")
    make: Callable[..., Model] = getattr(module, f"{kind}_model")
    for place, option in enumerate(options):
        allowed = OPTIONS[kind][place] if place < len(OPTIONS[kind]) else ()
        if option not in allowed:
            advice = f"choose {', '.join(allowed)}" if allowed else "no further option is possible"
            if kind == "thruster" and allowed:
                advice += ", or the time [s] between copies of the command, above 0.0001 and below 1"
            raise SeatrialError(f"no model {source!r}: {kind} has no option {option!r} at this place; {advice}")
    return make(*options)


def _own_model_meant(source: str) -> str:
    """Return the correction of a name of a user-defined model without ``.py`` or without the object; "" for others.

    The file must exist: ``boat:make`` and ``boat.make`` are taken for ``boat.py:make`` if there is a file ``boat.py``.
    """
    if source.endswith(".py"):
        return f"give the name of the model in the file too, {source}:NAME" if Path(source).is_file() else ""
    for separator in ":.":
        file, _, name = source.rpartition(separator)
        if file and Path(f"{file}.py").is_file():
            return f"give the file with its ending, {file}.py:{name}"
    return f"give the file with its ending, and the name of the model in it, {source}.py:NAME" * (
        bool(source) and Path(f"{source}.py").is_file()
    )


def _model_of_package(source: str, kind: str, options: Sequence[str]) -> Model:
    """Return a model of another package: the result of its function, called with the options in the model's name.

    Parameters
    ----------
    source : str
        Name with options, for messages. It becomes the source of the model.
    kind : str
        Name of the package's entry point in the group ``seatrial.models``.
    options : Sequence[str]
        Options behind the name, which are the positional arguments of the function, as texts.

    Raises
    ------
    SeatrialError
        If no package has such a model, or if its function fails or does not return a Model.
    """
    point = plugins(GROUP).get(kind)
    if point is None:
        names = ", ".join((*BUILT_IN, *plugins(GROUP)))
        if meant := _own_model_meant(source):
            raise SeatrialError(f"no model {source!r}: {meant}")
        raise SeatrialError(f"no model {source!r}: choose {names}, or FILE.py:NAME for your own")
    make: Callable[..., Any] = load_plugin(point, Callable)  # type: ignore[arg-type]
    try:
        model = make(*options)
    except Exception as error:  # code of others may raise anything
        raise SeatrialError(
            f"model {source!r} ({point.value}): the package cannot make it: {type(error).__name__}: {error}; ask the "
            "author of the package"
        ) from error
    if not isinstance(model, Model):
        raise SeatrialError(
            f"model {source!r} ({point.value}) is a {type(model).__name__}, not a seatrial Model; ask the author of "
            "the package"
        )
    return replace(model, source=source)  # model.toml finds the model again by its source


def _is_delay_step(options: Sequence[str]) -> bool:
    """Return whether the options of a thruster model are exactly one number above 1e-4 and below 1.

    The number, a text here, is the delay [s] between copies of the thruster's command. Any other options give False,
    also none and a text that is no number.
    """
    try:
        return len(options) == 1 and 1e-4 < float(options[0]) < 1.0
    except ValueError:
        return False


def _horizontal_by_options(source: str, options: Sequence[str], sensors: Sequence[str] | None) -> Model:
    """Return a horizontal model with the options of its name.

    Parameters
    ----------
    source : str
        Whole name, for messages, and source of a model with a random-walk current.
    options : Sequence[str]
        Options behind the name, in any order: ``shaft`` (default), ``command``, ``force`` or ``general``;
        ``no-current``, ``random-walk-current``; ``symmetric-arms``; ``thrust-of-left``, ``thrust-of-right`` or
        ``thrust-of-both``. Of several inputs, the first is used. With both options of the current, it is a random walk
        from zero, without a constant part.
    sensors : Sequence[str], optional
        Names of the sensors that the log contains. Other sensors are left out. None, or no sensor of the model: the
        standard sensors.

    Raises
    ------
    SeatrialError
        If an option is unknown, or if ``symmetric-arms`` and ``general`` (no thrusters) are combined.
    """
    from seatrial.ident.models.horizontal import (
        SENSORS,
        STANDARD,
        SYMMETRIC,
        THRUST_OF,
        horizontal_model,
        symmetric_arms,
    )

    kinds, currents = ("shaft", "command", "force", "general"), ("no-current", "random-walk-current")
    unknown = [o for o in options if o not in (*kinds, *currents, SYMMETRIC, *THRUST_OF.values())]
    if unknown or (SYMMETRIC in options and "general" in options):
        others = f"{', '.join(currents)} or {SYMMETRIC} (not with general, which has no thrusters)"
        raise SeatrialError(f"no model {source!r}; after horizontal: give one of {', '.join(kinds)}, and {others}")
    propulsion: Any = next((o for o in options if o in kinds), "shaft")
    chosen = [s for s in SENSORS if s in sensors] if sensors is not None else None
    current = "no-current" not in options
    model = horizontal_model(propulsion, tuple(chosen or STANDARD), current=current)
    model = symmetric_arms(model) if SYMMETRIC in options else model
    model = replace(model + current_walk(), source=source) if "random-walk-current" in options else model
    return _with_thrust_of_options(model, options)


def _with_thrust_of_options(model: Model, options: Sequence[str]) -> Model:
    """Return the model with the given thrust for the side that an option names; unchanged without such an option."""
    from seatrial.ident.models.horizontal import THRUST_OF, with_thrust_of

    for of, option in THRUST_OF.items():
        if option in options:
            return with_thrust_of(model, of)
    return model


def _nomoto_by_options(source: str, options: Sequence[str], sensors: Sequence[str] | None) -> Model:
    """Return a Nomoto model with the options of its name.

    Parameters
    ----------
    source : str
        Whole name, for messages, and source of a model with a random-walk current.
    options : Sequence[str]
        Options behind the name, in any order: ``sampled`` (times of the inputs are uncertain), and ``no-current`` or
        ``random-walk-current``.
    sensors : Sequence[str], optional
        Names of the sensors that the log contains. Other sensors are left out. None, or no sensor of the model: all
        sensors of the model.

    Raises
    ------
    SeatrialError
        If an option is unknown, or if both options of the current are given.
    """
    from seatrial.ident.models.nomoto import SEEN, nomoto_model

    if [o for o in options if o != "sampled"] not in ([], ["no-current"], ["random-walk-current"]):
        raise SeatrialError(f"no model {source!r}; after nomoto: give sampled, and no-current or random-walk-current")
    chosen = SEEN if sensors is None else [s for s in SEEN if s in sensors] or SEEN
    model = nomoto_model(chosen, current="no-current" not in options, sampled="sampled" in options)
    return replace(model + current_walk(), source=source) if "random-walk-current" in options else model


def _kinematic_by_options(source: str, options: Sequence[str], sensors: Sequence[str] | None) -> Model:
    """Return a kinematic model with the options of its name.

    Parameters
    ----------
    source : str
        Whole name, for messages, and source of a model with a random-walk current.
    options : Sequence[str]
        Options behind the name. The first is ``shaft`` or ``force``; without options, ``shaft`` is used. The others are
        ``yaw``, ``no-current``, ``random-walk-current``, ``symmetric-arms`` and ``thrust-of-left``, ``-right`` or
        ``-both``, in any order. With both options of the
        current, it is a random walk from zero, without a constant part.
    sensors : Sequence[str], optional
        Names of the sensors that the log contains. Other sensors are left out. None, or no sensor of the model: all
        sensors of the model.

    Raises
    ------
    SeatrialError
        If an option is unknown or at the wrong place.
    """
    from seatrial.ident.models.horizontal import SYMMETRIC, THRUST_OF, symmetric_arms
    from seatrial.ident.models.kinematic import SEEN, kinematic_model

    unknown = [
        o
        for k, o in enumerate(options)
        if o
        not in (("shaft", "force"), ("yaw", "no-current", "random-walk-current", SYMMETRIC, *THRUST_OF.values()))[k > 0]
    ]
    if unknown:
        raise SeatrialError(
            f"no model {source!r}: write kinematic:shaft or kinematic:force, followed by any of :yaw, :no-current, "
            f":random-walk-current, :{SYMMETRIC} and :{THRUST_OF['left']} (or right, both)"
        )
    chosen = SEEN if sensors is None else [s for s in SEEN if s in sensors] or SEEN
    propulsion: Any = options[0] if options else "shaft"
    model = kinematic_model(propulsion, chosen, current="no-current" not in options, yaw="yaw" in options)
    model = symmetric_arms(model) if SYMMETRIC in options else model
    model = replace(model + current_walk(), source=source) if "random-walk-current" in options else model
    return _with_thrust_of_options(model, options)


def own_model(source: str) -> Model:
    """Run the Python file of the user and return the model that it defines.

    The model is evaluated once with symbols, so that errors in its functions are found here.

    Parameters
    ----------
    source : str
        ``FILE.py:NAME``. NAME is a Model, or a function without arguments that returns a Model. The text becomes the
        source of the model.

    Raises
    ------
    SeatrialError
        If the file cannot be loaded, NAME is no Model, or a function of the model cannot be evaluated.
    """
    file, _, name = source.rpartition(":")
    model = load_object(source)
    if not isinstance(model, Model):
        raise SeatrialError(
            f"{file}: {name} is a {type(model).__name__}, not a seatrial Model; name a Model, or a function without "
            f"arguments that returns one{' (an effect is given with --effects FILE.py)' * isinstance(model, Effect)}"
        )
    return check_user_model(replace(model, source=source), Path(file))  # model.toml stores the source to load it again
