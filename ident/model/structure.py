"""A model: named states, inputs, sensors and parameters, and the functions between them.

The functions are plain Python over scalars (numpy functions work; the engine calls them with symbols).
They are ordered in stages, each reading and writing one bag of signals:

    shaft -> thrust -> force -> rate -> output

An effect is a part that hooks in behind a stage; ``model + effect`` is a model again. What has to see the work of all
other effects of a stage hooks in behind one of its ``LATER`` places, so that it does not matter which was added first.
A model of one's own needs no stages: ``plain_model`` takes ``f(x, u, p)`` and ``h(x, u, p)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import update_wrapper
from types import SimpleNamespace
from typing import Any, Literal

from seatrial.ident.model.parameter import Parameter, ParameterRole, tap_name

HISTORY_STEP = 0.1  # s between the taps of an input
PARAMETERS = "parameters"  # a hook of this label changes parameters before the first stage
# By stage: places for effects behind all that hook in at the stage itself, in this order
LATER: Mapping[str, tuple[str, ...]] = {
    "thrust": ("thrust_loss",),  # factors on the thrust that was made
    "force": ("loose_mass",),  # what takes its part of the whole force
    "rate": ("carried",),  # what the boat's acceleration moves
    # a fix that is late, of where the antenna is; sensors that stand askew or err with heading; their own offsets
    "output": ("late_fix", "axes", "reading"),
}


class Named(SimpleNamespace):
    """Scalars, symbols or columns by name. AttributeError of a name that is not there says which there are."""

    _kind = "signal"

    def __getattr__(self, name: str) -> Any:  # only what is not there comes here
        there = ", ".join(vars(self)) or "none"
        raise AttributeError(f"no {self._kind} {name!r}; there is {there}", name=name, obj=self)


class Signals(Named):
    """``x``, ``u``, ``p`` by name, ``rate`` and ``y`` as dictionaries, and the rest as each model names it (vehicle
    models: ``n`` and ``f`` by thruster, ``X``, ``Y``, ``N``). ``again``: a bag of other states, inputs and parameters,
    by name, in which all has run up to the rates, for an effect that has to know what they were."""

    x: Any
    u: Any
    p: Any
    rate: dict[str, Any]
    y: dict[str, Any]
    again: Callable[[Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]], Signals]

    def state_or_input(self, name: str) -> Any:
        """The state of this name where there is one, else the input."""
        return getattr(self.x if hasattr(self.x, name) else self.u, name)


ModelFunction = Callable[[Signals], None]
Hold = Literal["zero", "average", "linear"]


class ModelKind(StrEnum):
    """What is modelled, which tells how its logs are read."""

    VEHICLE = "vehicle"
    BENCH = "bench"  # a thruster on its bench, from a log of it alone
    NOISE = "noise"  # a sensor at rest


Place = Literal["actuator", "hull", "environment", "sensor", "bench"]


@dataclass(frozen=True)
class State:
    """``noise``: diffusion in unit/sqrt(s), a number or the name of the parameter that holds it.
    ``x0`` and ``sd0``: mean and standard deviation at the start of a record, numbers or, for the mean, the
    name of a parameter; ``from_output`` starts it at the first measurement of that output. ``nuisance``: a disturbance
    or an offset of a sensor, which a controller does not want."""

    name: str
    unit: str = ""
    meaning: str = ""
    noise: float | str = 0.0
    x0: float | str = 0.0
    sd0: float | str = 1.0
    from_output: str = ""
    nuisance: bool = False


@dataclass(frozen=True)
class Input:
    """A known signal.

    Attributes:
        hold: ``zero``: zero-order, and every change is a row unless it is averaged; ``average``: zero-order, and
            between rows a straight line of the same mean and first moment; ``linear`` between samples.
        angle: unwrapped before it is interpolated.
        label: what people see it as; None: its name; empty: they do not look at it.
        tap_of: the signal that this one is a delayed copy of.
        tap: that many steps later (negative: earlier), made of the signal; 0: the data have it.
        delay: by which the copy is later [s].
        prefilter: forces follow it at once, and where sensors are averaged, it is averaged over as long; not so for a
            command that a lag of the model smooths by more, nor for a sensor's reading.
    """

    name: str
    unit: str = ""
    hold: Hold = "zero"
    angle: bool = False
    label: str | None = None
    tap_of: str = ""
    tap: int = 0
    delay: float = 0.0
    prefilter: bool = True

    def delayed(self, tap: int, step: float = HISTORY_STEP) -> Input:
        """This input ``tap`` steps [s] ago, named ``NAME~tap``; itself for none."""
        if not tap:
            return self
        return replace(self, name=tap_name(self.name, tap), label="", tap_of=self.name, tap=tap, delay=step * tap).held(
            self.hold
        )

    def like(self, source: Input) -> Input:
        """This delayed copy, held and averaged as its source is."""
        return replace(self.held(source.hold), prefilter=source.prefilter)

    def held(self, hold: str) -> Input:
        """This input as a log holds its signal; of a copy no change is a row. Empty: as it is."""
        if hold == "zero" and (self.tap or self.hold == "average"):
            hold = "average"
        return replace(self, hold=hold) if hold else self  # type: ignore[arg-type]


@dataclass(frozen=True)
class Output:
    """``noise``: standard deviation of the white measurement noise, the name of a parameter."""

    name: str
    unit: str = ""
    noise: str = ""
    angle: bool = False  # innovations are wrapped to (-pi, pi]
    robust: bool = False  # outliers are allowed (seatrial.ident.model.outlier_density)


@dataclass(frozen=True)
class Sensor:
    """Outputs that arrive together; a sample of a sensor is there as a whole or not at all. ``averaged``: over a row's
    time, where samples are closer; else one of them is taken, as of what follows the inputs within that time."""

    name: str
    outputs: tuple[Output, ...]
    averaged: bool = True


@dataclass(frozen=True)
class ForceCurve:
    """A residual quantity as a function of one variable, or of the products of two.

    Attributes:
        force: name of the ``Residual``, ``X``.
        variable: name of the ``Variable``, ``u``.
        second: of a product's other variable; empty for a function of one.
    """

    force: str
    variable: str
    second: str = ""

    @property
    def variables(self) -> str:
        """The variables as people read them: ``u``, or ``u, r``."""
        return f"{self.variable}, {self.second}" if self.second else self.variable


class EffectKind(StrEnum):
    """What an effect is a model of."""

    CATALOGUE = "catalogue"  # a named physical effect
    BETWEEN_RUNS = "between-runs"  # a parameter that differs between runs
    NONPARAMETRIC = "nonparametric"  # a force as a fitted function of a variable
    LAGGED = "lagged"  # a force of first order behind an input
    RESONANT = "resonant"  # a force of second order behind an input
    DISTURBANCE = "disturbance"  # a disturbance force, for the filter
    SENSOR_OFFSET = "sensor-offset"  # a walking offset or an age of a sensor, for the filter

    @property
    def unknown(self) -> bool:
        """Whether it has no name in any catalogue."""
        return self in (EffectKind.NONPARAMETRIC, EffectKind.LAGGED, EffectKind.RESONANT)

    @property
    def nuisance(self) -> bool:
        """Whether it is there for the filter's sake: no part of the boat."""
        return self in (EffectKind.DISTURBANCE, EffectKind.SENSOR_OFFSET)


def curve_name(kind: EffectKind, curve: ForceCurve) -> str:
    """The display name of an effect that no catalogue lists: ``X(u)``, ``N(u, r)``, ``X(past of n_sum)``."""
    way = {EffectKind.LAGGED: "past of ", EffectKind.RESONANT: "swing after "}.get(kind, "")
    return f"{curve.force}({way}{curve.variables})"


@dataclass(frozen=True)
class Effect:
    """A part that changes a model: a candidate for what the model lacks, or a disturbance it needs.

    ``hooks`` maps a stage, or a place behind one (``LATER``), to a function that runs after it (``PARAMETERS``: before
    all of them). At the parameters' given values the effect does nothing. ``requires`` names signals a model must
    provide (``f``: thrust by thruster).
    """

    name: str
    title: str
    hooks: Mapping[str, ModelFunction]
    parameters: tuple[Parameter, ...] = ()
    states: tuple[State, ...] = ()
    inputs: tuple[Input, ...] = ()
    place: Place = "hull"
    formula: str = ""
    source: str = ""
    experiment: str = ""
    requires: tuple[str, ...] = ()
    one_sided: bool = False  # the first parameter cannot be negative: its lower bound is 0
    alternatives: tuple[str, ...] = ()
    nests: tuple[str, ...] = ()  # effects that it is for some values of its parameters: it always explains as much
    scan: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # values to try where there is no gradient
    kind: EffectKind = EffectKind.CATALOGUE
    curve: ForceCurve | None = None  # of an effect that no catalogue lists: what depends on what
    span: tuple[float, float] | None = None  # of a nonparametric one: the range of its variable that it covers
    parametric_form_of: ForceCurve | None = None  # it is one shape of this curve; others differ in shape only
    nonparametric_of: ForceCurve | None = None  # a series for this curve, of no shape: its name says no more
    fixed_point: bool = False  # it is at one place over ground: x and y of all logs must count from one origin

    def is_table_of(self, curve: ForceCurve | None) -> bool:
        """Whether it is this curve as a nonparametric effect."""
        return self.kind is EffectKind.NONPARAMETRIC and self.curve is not None and self.curve == curve


@dataclass(frozen=True)
class StartGrid:
    """Alternative initial values for a multimodal likelihood: every combination is tried, the best are fitted.

    Attributes:
        names: parameters; the first tells starts apart.
        values: values of each to try.
        apart: least distance of two starts in the first parameter, in its unit.
        gaining: only those that are likelier than the fit, with all else as it was fitted.
    """

    names: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    apart: float
    gaining: bool = False


@dataclass(frozen=True)
class Residual:
    """Where something unexplained may enter a model: a force on the hull, a force on the load cell, a reading.

    ``state``: the disturbance that stands for it (``seatrial.ident.models.disturbances``); ``scale``: what an unknown
    table of it may reach, one standard deviation of the prior; ``add``: how an extra of its unit enters, behind
    ``stage``;
    ``of``: the variables that it may depend on, all of the model's where none are named; ``place`` and ``requires``:
    of the nonparametric effects on it. ``relative``: a factor, whose part at zero of the variable belongs to other
    parameters, and for which no disturbance stands.
    """

    name: str
    unit: str
    state: str
    scale: float
    title: str
    add: Callable[[Signals, Any], None]
    stage: str = "force"
    of: tuple[str, ...] = ()
    place: Place = "hull"
    requires: tuple[str, ...] = ()
    relative: bool = False


@dataclass(frozen=True)
class ThrusterPair:
    """Shaft speeds (``n``) or thrusts (``f``) of two thrusters, their mean or their difference."""

    quantity: Literal["n", "f"]
    difference: bool


@dataclass(frozen=True)
class Variable:
    """What a residual may depend on, read from the signals of a row. ``angle``: wrapped, and described by harmonics;
    ``functions``: how many splines describe it else."""

    name: str
    unit: str
    read: Callable[[Signals], Any]
    angle: bool = False
    functions: int = 6
    pair: ThrusterPair | None = None  # of two thrusters: what a force may follow late


@dataclass(frozen=True)
class Model:
    """Continuous time, ``dx = f(x, u; p) dt + noise``, and ``y_k = h(x(t_k), u(t_k); p) + e_k``."""

    name: str
    states: tuple[State, ...]
    inputs: tuple[Input, ...]
    sensors: tuple[Sensor, ...]
    parameters: tuple[Parameter, ...]
    stages: tuple[tuple[str, ModelFunction], ...]
    provides: tuple[str, ...] = ()  # signals that effects may require
    effects: tuple[Effect, ...] = field(default=())
    source: str = ""  # how to make it again: "horizontal", "FILE.py:NAME"
    # what a diagnosis looks for: unexplained quantities, what they may depend on, and products of two of these
    residuals: tuple[Residual, ...] = ()
    variables: tuple[Variable, ...] = ()
    products: tuple[tuple[str, str], ...] = ()
    block: float = 5.0  # s, several times the memory of what is unexplained: scores are summed over blocks as long
    start_grid: StartGrid | None = None  # where else a fit starts, for a multimodal likelihood
    kind: ModelKind = ModelKind.VEHICLE
    horizon: float = 10.0  # s that predictions go ahead where nobody says otherwise
    disturbance: Effect | None = None  # what it does not explain, as states; None: forces on the hull, where it has one
    max_step: float = 0.1  # s between two rows, at most, for its quickest states
    second_order: bool = False  # the filter's mean goes with the curvature of the rates (engine.graphs)

    def __post_init__(self) -> None:
        for kind, names in (
            ("state", [s.name for s in self.states]),
            ("input", [i.name for i in self.inputs]),
            ("output", [o.name for o in self.outputs]),
            ("parameter", [p.name for p in self.parameters]),
        ):
            twice = sorted({n for n in names if names.count(n) > 1})
            if twice:
                raise ValueError(f"model {self.name}: {kind} {twice[0]} is defined twice")
        known, seen = {p.name for p in self.parameters}, {o.name for o in self.outputs}
        for what, name in (
            *((f"the noise of {s.name}", s.noise) for s in self.states),
            *((f"the noise of {o.name}", o.noise) for o in self.outputs),
            *((f"x0 of the state {s.name}", s.x0) for s in self.states),
            *((f"sd0 of the state {s.name}", s.sd0) for s in self.states),
        ):
            if isinstance(name, str) and name not in known:
                raise ValueError(f"model {self.name}: {what} names no parameter: {name!r}")
        for s in self.states:
            if s.from_output and s.from_output not in seen:
                raise ValueError(
                    f"model {self.name}: from_output of the state {s.name} names no output: "
                    f"{s.from_output!r}; there is {', '.join(sorted(seen))}"
                )

    @property
    def outputs(self) -> tuple[Output, ...]:
        return tuple(o for s in self.sensors for o in s.outputs)

    @property
    def values(self) -> dict[str, float]:
        return {p.name: p.value for p in self.parameters}

    def parameter(self, name: str) -> Parameter:
        for p in self.parameters:
            if p.name == name:
                return p
        raise KeyError(f"model {self.name} has no parameter {name!r}; it has {', '.join(self.values)}")

    def bag(self, x: Any, u: Any, p: Any) -> Signals:
        """States, inputs and parameters by name, before any stage has run; scalars, symbols or columns."""
        return Signals(
            x=States(**dict(zip([v.name for v in self.states], x, strict=True))),
            u=Inputs(**dict(zip([v.name for v in self.inputs], u, strict=True))),
            p=Parameters(**dict(zip([v.name for v in self.parameters], p, strict=True))),
            rate={},
            y={},
        )

    def signals(self, x: Any, u: Any, p: Any) -> Signals:
        """Run all stages on scalars or symbols in the order of states, inputs and parameters."""
        s = self.bag(x, u, p)
        for effect in self.effects:
            if PARAMETERS in effect.hooks:
                effect.hooks[PARAMETERS](s)
        s.again = lambda x, u, p: self._until_rates(s, x, u, p)
        for label, stage in self.stages:
            self._run(label, stage, s)
        return s

    def _run(self, label: str, stage: ModelFunction, s: Signals) -> None:
        stage(s)
        for place in (label, *LATER.get(label, ())):
            for effect in self.effects:
                if place in effect.hooks:
                    effect.hooks[place](s)

    def _until_rates(self, s: Signals, x: Mapping[str, Any], u: Mapping[str, Any], p: Mapping[str, Any]) -> Signals:
        """The stages once more, up to the rates, with some states, inputs and parameters other than those of ``s``."""
        x, u, p = vars(s.x) | x, vars(s.u) | u, vars(s.p) | p
        other = Signals(x=States(**x), u=Inputs(**u), p=Parameters(**p), rate={}, y={})
        for label, stage in self.stages:
            if label == "output":
                break
            self._run(label, stage, other)
        return other

    def with_values(self, values: Mapping[str, float]) -> Model:
        """The same model with other parameter values; unknown names are an error."""
        unknown = set(values) - set(self.values)
        if unknown:
            raise KeyError(f"model {self.name} has no parameter {sorted(unknown)[0]!r}")
        return replace(self, parameters=tuple(p.at(values.get(p.name, p.value)) for p in self.parameters))

    def with_free(self, names: Iterable[str]) -> Model:
        """Free exactly the named parameters and fix all others."""
        wanted = set(names)
        unknown = wanted - set(self.values)
        if unknown:
            raise KeyError(f"model {self.name} has no parameter {sorted(unknown)[0]!r}")
        return replace(self, parameters=tuple(replace(p, free=p.name in wanted) for p in self.parameters))

    @property
    def free(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters if p.free)

    @property
    def considered(self) -> tuple[str, ...]:
        """Parameters that are not estimated, but whose uncertainty goes into the errors of those that are."""
        return tuple(p.name for p in self.parameters if p.considered_sd is not None)

    @property
    def noises(self) -> frozenset[str]:
        """Parameters that only set covariances: standard deviations and diffusions."""
        named = [o.noise for o in self.outputs] + [s.noise for s in self.states] + [s.sd0 for s in self.states]
        return frozenset(n for n in named if isinstance(n, str))

    def role(self, name: str) -> ParameterRole:
        """What a parameter is for: by its use as noise or as an initial state, else as it says itself."""
        if name in self.noises:
            return ParameterRole.NOISE
        if name in {s.x0 for s in self.states}:
            return ParameterRole.INITIAL_STATE
        return self.parameter(name).role

    @property
    def noise_parameters(self) -> frozenset[str]:
        """Parameters of the noise alone: standard deviations, diffusions, and what else no prediction of the mean
        depends on, such as the memory of a disturbance that is zero on average."""
        disturbance = {p.name for p in self.parameters if self.role(p.name) is ParameterRole.DISTURBANCE}
        return self.noises | disturbance

    def replace_parameters(self, *new: Parameter) -> Model:
        by_name = {p.name: p for p in new}
        return replace(self, parameters=tuple(by_name.get(p.name, p) for p in self.parameters))

    def __add__(self, effect: Effect) -> Model:
        missing = self._missing(effect)
        if missing:
            raise ValueError(
                f"effect {effect.name} needs the signal {sorted(missing)[0]!r}, which model {self.name} has not"
            )
        own = {i.name: i for i in self.inputs}
        return replace(
            self,
            states=self.states + effect.states,
            inputs=self.inputs
            + tuple(i.like(own[i.tap_of]) if i.tap_of in own else i for i in effect.inputs if i.name not in own),
            parameters=self.parameters + effect.parameters,
            effects=(*self.effects, effect),
        )

    def without(self, name: str) -> Model:
        """The model without its effect ``name``: without its hooks, states and parameters, and without those of its
        inputs that no other effect reads. The model itself where it has no such effect."""
        gone = [e for e in self.effects if e.name == name]
        kept = tuple(e for e in self.effects if e.name != name)
        lost = {i.name for e in gone for i in e.inputs} - {i.name for e in kept for i in e.inputs}
        states, parameters = {s.name for e in gone for s in e.states}, {p.name for e in gone for p in e.parameters}
        return replace(
            self,
            states=tuple(s for s in self.states if s.name not in states),
            inputs=tuple(i for i in self.inputs if i.name not in lost),
            parameters=tuple(p for p in self.parameters if p.name not in parameters),
            effects=kept,
        )

    def accepts(self, effect: Effect) -> bool:
        """Whether the effect can be added, and neither it nor what it is about is there already."""
        return self.refusal(effect) is None

    def refusal(self, effect: Effect) -> str | None:
        """Why the effect cannot be added; None: it can."""
        if missing := self._missing(effect):
            return f"it needs the signal {min(missing)!r}, which model {self.name} has not"
        had = {e.name for e in self.effects} | set(self.values) | {s.name for s in self.states}
        there = had & {effect.name, *(p.name for p in effect.parameters), *(s.name for s in effect.states)}
        return f"model {self.name} has {min(there)} already" if there else None

    def _missing(self, effect: Effect) -> set[str]:
        """Signals that an effect requires and the model does not provide; a hull moves in the plane."""
        provided = {*self.provides, *(["plane"] if "hull" in self.provides else [])}
        return set(effect.requires) - provided


def plain_model(
    name: str,
    *,
    f: Callable[[Any, Any, Any], Mapping[str, Any]],
    h: Callable[[Any, Any, Any], Mapping[str, Any]],
    states: tuple[State, ...],
    inputs: tuple[Input, ...],
    sensors: tuple[Sensor, ...],
    parameters: tuple[Parameter, ...],
    source: str = "",
) -> Model:
    """A model from ``f(x, u, p) -> {state: rate}`` and ``h(x, u, p) -> {output: value}``."""

    def rate(s: Signals) -> None:
        s.rate.update(_by_name(f(s.x, s.u, s.p), "f", "{state: rate}"))

    def output(s: Signals) -> None:
        s.y.update(_by_name(h(s.x, s.u, s.p), "h", "{output: value}"))

    for stage, own in ((rate, f), (output, h)):
        update_wrapper(stage, own)  # so that an error is found in the user's own lines
    return Model(name, states, inputs, sensors, parameters, (("rate", rate), ("output", output)), source=source)


def _by_name(found: Any, function: str, wanted: str) -> Mapping[str, Any]:
    if not isinstance(found, Mapping):
        raise TypeError(f"{function} returns a {type(found).__name__}, not a dictionary {wanted}")
    return found


def resolve_initial_states(states: Iterable[State], sensors: Iterable[Sensor]) -> tuple[State, ...]:
    """The states; those that begin at an output that none of the sensors has begin at their ``x0``."""
    seen = {o.name for s in sensors for o in s.outputs}
    return tuple(s if s.from_output in seen else replace(s, from_output="") for s in states)


class States(Named):
    _kind = "state"


class Inputs(Named):
    _kind = "input"


class Parameters(Named):
    _kind = "parameter"
