"""Export of a fitted model: one file for each target (docs/formats/export.md)."""

from __future__ import annotations

from collections.abc import Callable

from seatrial.ident.estimation import SavedModel
from seatrial.ident.export import c, casadi_file, python, ros2
from seatrial.ident.export.codegen import Content, collect_content

TARGETS: dict[str, Callable[[Content], str]] = {
    "python": python.write,
    "casadi": casadi_file.write,
    "c": c.write,
    "ros2": ros2.write,
}


def export(saved: SavedModel, target: str, *, name: str | None = None, nuisance: bool = False) -> str:
    """Return the text of the exported file of a fitted model.

    Parameters
    ----------
    saved : SavedModel
        Model with its provenance, standard errors and validity.
    target : str
        ``python``, ``casadi``, ``c`` or ``ros2``; any other text raises KeyError.
    name : str, optional
        Prefix of the functions, or name of the node; by default the model's name.
    nuisance : bool
        Whether disturbance forces and sensor biases are kept as states.

    Raises
    ------
    ValueError
        If the model uses an operation that cannot be exported.
    """
    return TARGETS[target](collect_content(saved, name=name, nuisance=nuisance))
