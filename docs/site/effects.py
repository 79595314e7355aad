"""Generator of docs/theory/effects.md from the catalogue of effects: ``python docs/site/effects.py``.

Effects of other installed packages are not listed.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Before the import of the project: the page must describe the tree of this file, not an installed package.
sys.path.insert(0, str(ROOT))

from docs.site.formulas import formula_tex  # noqa: E402
from seatrial.ident.effects import catalogue, separating_experiment  # noqa: E402
from seatrial.ident.model import Effect  # noqa: E402

PAGE = ROOT / "docs/theory/effects.md"
PLACES = {
    "actuator": "Propulsion",
    "hull": "Hull",
    "environment": "Wind, waves, current, lines and shores",
    "sensor": "Sensors",
    "bench": "Thruster bench",
}
INTRODUCTION = """\
# The catalogue of effects

<!-- written by: python docs/site/effects.py -->

`seatrial ident diagnose` tests these effects against the residuals of a model, and adds those that explain them. Each
effect has a name, for the options `--effect` of `ident vehicle` and `--exclude` of `ident diagnose` and for Python, and
a formula. X, Y and N are the forces and the moment in body axes, u, v and r the velocities through the water, psi is
the heading, n a shaft speed (1: full speed ahead) and f the thrust of a thruster. An arrow means that the effect
replaces the quantity on its left by the value on its right. A condition in brackets is 1 if it is true, and 0
otherwise.

A residual that no effect of the catalogue explains is described by a curve ([diagnosis](diagnosis.md)). You can
[add an effect](../how-to/add-an-effect.md) of your own.

The experiment is the one that shows the effect best. Competing effects explain similar data: a diagnosis that cannot
distinguish them names both. A model accepts only effects whose quantities it has: an effect on the thrust of a
thruster needs a model with thrusters."""


def built_in() -> dict[str, Effect]:
    """Return the effects of the project by name, without those of other installed packages."""
    modules = {name: next(iter(effect.hooks.values())).__module__ for name, effect in catalogue().items()}
    return {name: catalogue()[name] for name, module in modules.items() if module.startswith("seatrial.ident.")}


def section(effect: Effect) -> list[str]:
    """Return the lines of one effect in Markdown."""
    tex = formula_tex(effect.formula)
    lines = [
        "",
        f"### {effect.name}",
        "",
        f"{effect.title[0].upper()}{effect.title[1:]}.",
        "",
        f"    {effect.formula}" if tex is None else f"$${tex}$$",
        "",
    ]
    for p in effect.parameters:
        unit = f" [{p.unit}]" if p.unit else ""
        each = ", one value for each log" if p.per_record else ""
        lines.append(f"- `{p.name}`{unit}: {p.meaning}{each}")
    if effect.causes:
        lines.append(f"- Look for: {effect.causes}")
    lines.append(f"- Experiment: {effect.experiment}")
    if effect.alternatives:
        links = ", ".join(f"[{name}](#{name})" for name in effect.alternatives)
        lines.append(f"- Competing effects: {links}")
    for other in effect.alternatives:
        if instead := separating_experiment(effect.name, other):
            unlike = f"A mission of thruster commands may not distinguish it from [{other}](#{other})"
            lines.append(f"- {unlike}. What does: {instead}")
    return [*lines, f"- Source: {effect.source}"]


def page() -> str:
    """Return the page in Markdown: one section for each place of effects, in which they are in alphabetical order."""
    lines = [INTRODUCTION]
    for place, title in PLACES.items():
        lines += ["", f"## {title}"]
        for effect in built_in().values():
            if effect.place == place:
                lines += section(effect)
    return "\n".join(lines) + "\n"


def main() -> int:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    print(f"written: {PAGE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
