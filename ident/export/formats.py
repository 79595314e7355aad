"""Export of a fitted model: one file for each target (docs/formats/export.md)."""

from __future__ import annotations

from collections.abc import Callable

from seatrial.ident.estimation import SavedModel
from seatrial.ident.export import c, casadi_file, python, ros2
from seatrial.ident.export.codegen import Content, content

TARGETS: dict[str, Callable[[Content], str]] = {
    "python": python.write,
    "casadi": casadi_file.write,
    "c": c.write,
    "ros2": ros2.write,
}


def export(saved: SavedModel, target: str, *, name: str | None = None, nuisance: bool = False) -> str:
    """The text of the file for a target: ``python``, ``casadi``, ``c`` or ``ros2``.

    name: prefix of functions, or the node, in place of the model's own name; nuisance: keep disturbance forces
    and sensor biases as states. Raises ValueError where the model cannot be written.
    """
    return TARGETS[target](content(saved, name=name, nuisance=nuisance))
