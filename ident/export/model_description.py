"""Description of an FMU: its variables, and the text of modelDescription.xml for FMI 2.0."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

from seatrial.ident.export.codegen import RELATIVE, Content, Program, comment, provenance_lines
from seatrial.ident.model import Parameter

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
# Units that are products of powers of base units
DERIVED_UNITS = {"N": {"kg": 1, "m": 1, "s": -2}, "Hz": {"s": -1}, "V": {"kg": 1, "m": 2, "s": -3, "A": -1}}
INVALID_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
STOP_S, STEP_S = 60.0, 0.05  # length and communication step of the default experiment
Role = Literal["input", "start", "before", "parameter", "state", "output"]


@dataclass(frozen=True)
class FmuVariable:
    """Scalar variable of an FMU.

    Attributes
    ----------
    name, unit, description : str
        Name in the FMU, unit and description.
    role : str
        ``input``: physical input. ``start``: state at the start. ``before``: physical input before the start.
        ``parameter``: parameter of the model. ``state``: state of the model. ``output``: output of a sensor.
    value : float or None
        Value at the start; None for states and outputs, which are computed.
    bounds : tuple of float
        Smallest and largest value; infinite if there is no bound.
    depends_on : tuple of int
        Indices of the physical inputs on which a state or an output depends without a step between them.
    """

    name: str
    unit: str
    description: str
    role: Role
    value: float | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)
    depends_on: tuple[int, ...] = ()


def variables(content: Content) -> list[FmuVariable]:
    """Return the variables of a model's FMU; the index of a variable is its value reference.

    The order is that of the C source: physical inputs, states at the start, inputs before the start, parameters, states
    and outputs. Names are those of the model. Outputs of sensors begin with ``sensor.``, parameters with ``p.``,
    initial states with ``start.`` and inputs before the start with ``before.``. A state with the name of an input
    begins with ``state.``.
    """

    def unit(shown: str) -> str:
        """Return a unit of the content for the file: a relative number has none, since its unit is not known."""
        return "" if shown == RELATIVE else shown

    inputs = list(zip(content.physical_inputs, content.history.inputs, strict=True))
    states = list(zip(content.states, content.model.states, strict=True))
    direct = _direct_inputs(content, content.programs[1])
    return [
        *(
            FmuVariable(
                n, unit(content.unit(i.unit)), _text(f"input {i.name}, held between communication points"), "input", 0.0
            )
            for n, i in inputs
        ),
        *(
            FmuVariable(
                f"start.{n}", unit(content.unit(s.unit)), _text(f"at the start: {s.meaning or s.name}"), "start", 0.0
            )
            for n, s in states
        ),
        *(
            FmuVariable(f"before.{n}", unit(content.unit(i.unit)), _text(f"{i.name} before the start"), "before", 0.0)
            for n, i in inputs
        ),
        *(
            FmuVariable(
                f"p.{n}",
                unit(content.parameter_unit(k)),
                _text(comment(content, k)),
                "parameter",
                p.value,
                parameter_bounds(p),
            )
            for k, (n, p) in enumerate(zip(content.parameters, content.exported_parameters, strict=True))
        ),
        *(
            FmuVariable(
                f"state.{n}" if n in content.physical_inputs else n,
                unit(content.unit(s.unit)),
                _text(s.meaning or s.name),
                "state",
            )
            for n, s in states
        ),
        *(
            FmuVariable(
                f"sensor.{n}",
                unit(content.unit(o.unit)),
                _text(f"output {o.name} without noise"),
                "output",
                depends_on=depends,
            )
            for n, o, depends in zip(content.outputs, content.model.outputs, direct, strict=True)
        ),
    ]


def parameter_bounds(p: Parameter) -> tuple[float, float]:
    """Return the smallest and the largest value that a parameter may have; its value lies between them.

    A parameter that is estimated by its logarithm is positive, and its lower bound is at least zero.
    """
    low, high = p.bounds
    low = max(low, 0.0) if p.transform == "log" else low
    return min(low, p.value), max(high, p.value)


def _direct_inputs(content: Content, program: Program) -> list[tuple[int, ...]]:
    """Return, for each result of a program, the indices of the physical inputs on which it depends directly."""
    source = dict(zip(content.symbols[1], content.history.sources, strict=True))
    found: list[frozenset[int]] = []
    for node in program.nodes:
        below = frozenset[int]().union(*(found[i] for i in node.operands))
        own = source.get(node.symbol, -1)
        found.append(below | {own} if own >= 0 else below)
    return [tuple(sorted(found[end])) for end in program.results]


def _text(words: str) -> str:
    """Return a text without characters that XML does not allow, in one line."""
    return " ".join(INVALID_IN_XML.sub(" ", words).split())


def model_description(content: Content, guid: str, version: str) -> bytes:
    """Return the text of modelDescription.xml, encoded as UTF-8.

    Parameters
    ----------
    content : Content
        Collected content of the model.
    guid : str
        Identifier that the source of the FMU contains, too.
    version : str
        Version of seatrial.
    """
    rows = variables(content)
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=content.name,
        guid=guid,
        description=_text(provenance_lines(content, "FMI 2.0")[0]),
        generationTool=f"seatrial {version}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    simulation = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=content.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        canNotUseMemoryManagementFunctions="true",
    )
    files = ElementTree.SubElement(simulation, "SourceFiles")
    ElementTree.SubElement(files, "File", name=f"{content.name}_fmu.c")
    _add_units(root, (v.unit for v in rows))
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError", description="Errors, which are always logged")
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime=repr(STOP_S), stepSize=repr(STEP_S))
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(rows):
        _add_variable(listed, reference, variable)
    _add_structure(root, rows)
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _add_variable(listed: ElementTree.Element, reference: int, variable: FmuVariable) -> None:
    """Add the element of a variable with this value reference to ``ModelVariables``."""
    causality, variability = {
        "input": ("input", "continuous"),
        "start": ("parameter", "fixed"),
        "before": ("parameter", "fixed"),
        "parameter": ("parameter", "tunable"),
        "state": ("output", "continuous"),
        "output": ("output", "continuous"),
    }[variable.role]
    element = ElementTree.SubElement(
        listed,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        description=variable.description,
        causality=causality,
        variability=variability,
    )
    if causality == "parameter":
        element.set("initial", "exact")
    if causality == "output":
        element.set("initial", "calculated")
    real = ElementTree.SubElement(element, "Real")
    if variable.unit:
        real.set("unit", _text(variable.unit))
    for key, bound in zip(("min", "max"), variable.bounds, strict=True):
        if math.isfinite(bound):
            real.set(key, repr(float(bound)))
    if variable.value is not None:
        real.set("start", repr(float(variable.value)))


def _add_structure(root: ElementTree.Element, rows: Sequence[FmuVariable]) -> None:
    """Add the element ``ModelStructure``: the outputs, and the inputs on which each of them depends directly.

    States and outputs of sensors are both outputs of the FMU. The same variables are the initial unknowns.
    ``rows`` are all variables in the order of their value references.
    """
    structure = ElementTree.SubElement(root, "ModelStructure")
    for title in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, title)
        for k, variable in enumerate(rows):
            if variable.role not in ("state", "output"):
                continue
            unknown = ElementTree.SubElement(unknowns, "Unknown", index=str(k + 1))
            if title == "Outputs":  # the initial values depend on parameters, too: without a list, on all
                unknown.set("dependencies", " ".join(str(i + 1) for i in variable.depends_on))


def _add_units(root: ElementTree.Element, units: Iterable[str]) -> None:
    """Add the element ``UnitDefinitions`` with each unit once, in the order of their first use; none for no unit."""
    named = [_text(unit) for unit in dict.fromkeys(units) if unit]
    if not named:
        return
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(named):
        unit = ElementTree.SubElement(definitions, "Unit", name=name)
        exponents = base_exponents(name)
        if exponents is not None:
            ElementTree.SubElement(unit, "BaseUnit", {k: str(n) for k, n in exponents.items() if n})


def base_exponents(unit: str) -> dict[str, int] | None:
    """Return the exponents of the base units in a unit such as ``kg m2/s``; None if it has another form.

    Factors are separated by spaces, and each factor behind a slash is divided by. ``1`` is no factor.
    """
    found: dict[str, int] = {}
    for sign, factor in re.findall(r"(/?)([^ /]+)", unit):
        match = re.fullmatch(r"([A-Za-z]+)(\d*)", factor)
        if factor == "1":
            continue
        if match is None or match[1] not in (*BASE_UNITS, *DERIVED_UNITS):
            return None
        power = int(match[2] or 1) * (-1 if sign else 1)
        for base, exponent in DERIVED_UNITS.get(match[1], {match[1]: 1}).items():
            found[base] = found.get(base, 0) + power * exponent
    return found
