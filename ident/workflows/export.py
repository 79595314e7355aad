"""Workflow of `seatrial ident export`: a fitted model as a file for another program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from keyword import iskeyword
from pathlib import Path
from typing import Literal

from seatrial.daq.errors import SeatrialError, warn
from seatrial.ident.estimation import (
    ThrustScale,
    load_model,
    model_file,
    thrust_scale_of,
    warn_if_unconverged,
    warn_of_run_means,
)
from seatrial.ident.export import export, file_name, prefix

MODULES = ("python", "casadi")  # targets whose files are Python modules
BLOCKS = ("gazebo", "vrx")
Target = Literal["python", "casadi", "c", "ros2", "fmu", "gazebo", "vrx"]


@dataclass(frozen=True)
class ExportRequest:
    """Options of `seatrial ident export`.

    Attributes
    ----------
    model
        The model.toml of the model.
    target
        Language or format of the file.
    name
        Prefix of functions and files. None: the name of the model.
    with_disturbance_states
        Whether disturbance forces and sensor biases are kept as states.
    thrusters
        The model.toml of the bench test of each thruster, by its name; the name ``""`` stands for all thrusters that
        are not named. Empty: the boat model is exported alone.
    thrust_curve
        Thrust curve of a joined model: that of the ``bench``, or that of the ``boat``.
    thrust_input
        Whether the inputs are thrusts in place of shaft speeds.
    source_only
        Whether an FMU has no binary.
    mass, inertia
        Mass [kg] and moment of inertia about the vertical axis [kg m2] of the boat without added mass, for Gazebo and
        VRX. None: not known.
    """

    model: Path
    target: Target
    name: str | None = None
    with_disturbance_states: bool = False
    thrusters: Mapping[str, Path] = field(default_factory=dict)
    thrust_curve: Literal["bench", "boat"] = "bench"
    thrust_input: bool = False
    source_only: bool = False
    mass: float | None = None
    inertia: float | None = None


@dataclass(frozen=True)
class ExportedModel:
    """Exported model: its usual file name, and its content as text or, of an FMU, as bytes."""

    file_name: str
    content: str | bytes


def export_model(request: ExportRequest) -> ExportedModel:
    """Return the exported file of a model, without writing it.

    Raises
    ------
    SeatrialError
        If a model cannot be read or exported, or if an option does not fit it or its target.

    Warns
    -----
    SeatrialWarning
        If the fit of a model did not converge, if thrust or arms of the model were not given (Gazebo and VRX have
        checks of their own), if ``request.name`` is not a valid name and another one is used, if parameters of effects
        differ between the fitted runs, and as `seatrial.ident.export.export`.
    """
    _check_options(request)
    saved = load_model(request.model)
    warn_of_run_means(saved.model)
    thrusters = {name: load_model(model_file(path)) for name, path in request.thrusters.items()}
    warn_if_unconverged(all(m.converged for m in (saved, *thrusters.values())))
    try:
        content = export(
            saved,
            request.target,
            name=request.name,
            nuisance=request.with_disturbance_states,
            thrusters=thrusters,
            own_curve=request.thrust_curve == "boat",
            thrust_input=request.thrust_input,
            source_only=request.source_only,
            mass=request.mass,
            inertia=request.inertia,
        )
    except ValueError as problem:
        raise SeatrialError(f"{request.model}: {problem}") from problem.__cause__
    if request.target not in BLOCKS and (line := _scale_warning(thrust_scale_of(saved.model))):
        warn(line)
    return ExportedModel(file_name(saved, request.target, request.name), content)


def _scale_warning(scale: ThrustScale) -> str:
    """Return a line on numbers of an exported file that are only ratios, with advice; "" if their scale is known."""
    if not (scale.relative or scale.relative_yaw):
        return ""
    lacking, options = [], []
    if scale.relative:
        lacking.append("masses, damping and forces are right only as ratios to the thrust c1 + c2, not in kg and N")
        options.append("`ident vehicle --thruster FILE` or `--fix c1=VALUE`")
    if scale.relative_yaw:
        lacking.append("inertia and damping in yaw are right only as ratios to the arms of the thrusters")
        options.append("the arms (position_m in the rig file, or [geometry] in the import map)")
    return (
        f"the scale of the model was not given: {'; '.join(lacking)}; the motion that they predict is right; for "
        f"numbers in SI units, fit the boat with {' and with '.join(options)}"
    )


def _check_options(request: ExportRequest) -> None:
    """Raise SeatrialError if an option has no effect on the target, and warn if the name has to be changed."""
    unused = {
        "--mass": request.mass is not None and request.target not in BLOCKS,
        "--inertia": request.inertia is not None and request.target not in BLOCKS,
        "--source-only": request.source_only and request.target != "fmu",
        "--with-disturbance-states": request.with_disturbance_states and request.target in BLOCKS,
    }
    for option, is_unused in unused.items():
        if is_unused:
            raise SeatrialError(f"{option} has no effect on an export to {request.target}; leave it out")
    if request.thrust_curve == "boat" and not request.thrusters:
        raise SeatrialError(
            "--thrust-curve chooses between the thrust curves of the boat and of a bench test, and no bench test was "
            "given; add --thruster with its model.toml, or leave out --thrust-curve"
        )
    if request.name is not None and (valid := prefix(request.name)) != request.name:
        warn(f"the name {request.name!r} is not valid in the file and becomes {valid}")


def warn_of_module_name(file: Path, target: Target) -> None:
    """Warn if an exported Python file has a name that ``import`` cannot have. Other targets are not checked."""
    if target in MODULES and (file.suffix != ".py" or not file.stem.isidentifier() or iskeyword(file.stem)):
        stem = prefix(file.name.removesuffix(".py"))
        valid = f"{stem}_model.py" if iskeyword(stem) else f"{stem}.py"
        warn(f"{file.name}: Python cannot import a file of this name; {valid} would be a valid one")
