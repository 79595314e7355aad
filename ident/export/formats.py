"""Export of a fitted model: one file for each target (docs/formats/export.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypedDict, Unpack

from seatrial.ident.estimation import SavedModel
from seatrial.ident.export import c, casadi_file, fmu, gazebo, python, ros2
from seatrial.ident.export.codegen import Content, collect_content, prefix
from seatrial.ident.export.joined import join, with_shaft_remark, with_thrust_input

TARGETS: dict[str, Callable[[Content], str]] = {  # source code and parameters
    "python": python.write,
    "casadi": casadi_file.write,
    "c": c.write,
    "ros2": ros2.write,
}
BLOCKS = {"gazebo": gazebo.write_gazebo, "vrx": gazebo.write_vrx}  # of simulators, which need the mass of the boat
# End of the usual file name of each target
SUFFIXES = {
    "python": ".py",
    "casadi": "_casadi.py",
    "c": ".h",
    "ros2": ".yaml",
    "fmu": ".fmu",
    "gazebo": ".sdf",
    "vrx": "_vrx.sdf",
}


class ExportOptions(TypedDict, total=False):
    """Options of `export`.

    Attributes
    ----------
    name : str or None
        Prefix of the functions, or name of the node or FMU; by default the model's name.
    nuisance : bool
        Whether disturbance forces and sensor biases are kept as states.
    thrusters : mapping
        Bench models of the thrusters by name, which are joined with the boat model (`seatrial.ident.export.joined`).
    own_curve : bool
        Whether a joined model keeps the thrust curve of the boat model.
    thrust_input : bool
        Whether the inputs are thrusts [N] in place of shaft speeds.
    source_only : bool
        Whether an FMU has no binary. Other targets ignore it.
    mass, inertia : float or None
        Mass [kg] and moment of inertia about the vertical axis [kg m2] of the boat without added mass, which Gazebo and
        VRX need. Other targets ignore them.
    """

    name: str | None
    nuisance: bool
    thrusters: Mapping[str, SavedModel]
    own_curve: bool
    thrust_input: bool
    source_only: bool
    mass: float | None
    inertia: float | None


def export(saved: SavedModel, target: str, **options: Unpack[ExportOptions]) -> str | bytes:
    """Return the content of the exported file of a fitted model: text, or the bytes of an FMU.

    Parameters
    ----------
    saved : SavedModel
        Model with its provenance, standard errors and validity.
    target : str
        A key of `SUFFIXES`; any other text raises KeyError.
    **options
        `ExportOptions`.

    Raises
    ------
    ValueError
        If the model uses an operation that cannot be exported.
    SeatrialError
        If the models cannot be joined, the inputs cannot be thrusts, the FMU cannot be compiled, or the target needs
        other options.

    Warns
    -----
    SeatrialWarning
        If the file cannot have a part of the model, with its name, or if the user has to fill in a value.
    """
    content = collect_content(saved, name=options.get("name"), nuisance=options.get("nuisance", False))
    if thrusters := options.get("thrusters"):
        content = join(content, thrusters, own_curve=options.get("own_curve", False))
    if options.get("thrust_input", False):
        content = with_thrust_input(content)
    content = with_shaft_remark(content)
    if target == "fmu":
        return fmu.write(content, source_only=options.get("source_only", False))
    if target in BLOCKS:
        return BLOCKS[target](content, mass=options.get("mass"), inertia=options.get("inertia"))
    return TARGETS[target](content)


def file_name(saved: SavedModel, target: str, name: str | None = None) -> str:
    """Return the usual name of an exported file, for example ``boat.fmu``; ``name`` is that given to `export`."""
    return prefix(name or saved.model.name) + SUFFIXES[target]
