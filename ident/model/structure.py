"""Model of a vehicle, thruster or sensor: named states, inputs, sensors and parameters, and the functions between them.

The functions are plain Python functions of scalars. They may use numpy functions, because the engine calls them with
symbols. The functions are ordered in stages. All stages read and write one `Signals` object:

    shaft -> thrust -> force -> rate -> output

An effect hooks in after a stage; ``model + effect`` is again a model. Some effects depend on the result of all other
effects of a stage. They hook in at one of the ``LATER`` places of the stage, so that the order in which effects are
added does not matter. User-defined models need no stages: ``plain_model`` takes ``f(x, u, p)`` and ``h(x, u, p)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import update_wrapper
from types import SimpleNamespace
from typing import Any, Literal

from seatrial.ident.model.delayed_inputs import HISTORY_STEP, tap_name
from seatrial.ident.model.parameter import Parameter, ParameterRole

PARAMETERS = "parameters"  # a hook with this label changes parameters before the first stage
# Places after each stage, in order, for effects that run after all effects at the stage itself
LATER: Mapping[str, tuple[str, ...]] = {
    "thrust": ("thrust_loss",),  # factors on the generated thrust
    "force": ("loose_mass",),  # a moving mass that takes a part of the total force
    "rate": ("carried",),  # states that the acceleration of the boat excites
    # latency of the antenna's position fix; misaligned axes and heading errors; offsets of the sensors
    "output": ("late_fix", "axes", "reading"),
}


class Named(SimpleNamespace):
    """Scalars, symbols or columns by name, read as attributes.

    An unknown name raises an AttributeError that lists the available names.
    """

    _kind = "signal"

    def __getattr__(self, name: str) -> Any:  # Python calls this only for missing attributes
        """Raise the AttributeError for a name that does not exist. Python calls this method only for such names."""
        available = ", ".join(vars(self)) or "none"
        raise AttributeError(f"no {self._kind} {name!r}; there is {available}", name=name, obj=self)


class Signals(Named):
    """Signals of one row, or of all rows as columns.

    Attributes
    ----------
    x, u, p : Named
        States, inputs and parameters by name.
    rate, y : dict
        Rates of the states per second, and outputs, by name.
    again : Callable
        ``again(x, u, p)`` runs the model again up to the rates, with other values of some states, inputs and
        parameters. It is for effects that depend on earlier rates.

    Each model adds signals of its own. Vehicle models add ``n`` and ``f`` by thruster, and ``X``, ``Y`` and ``N``.
    """

    x: Any
    u: Any
    p: Any
    rate: dict[str, Any]
    y: dict[str, Any]
    again: Callable[[Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]], Signals]

    def state_or_input(self, name: str) -> Any:
        """Return the state of this name if there is one, otherwise the input.

        Raises
        ------
        AttributeError
            If there is neither. The message lists the inputs.
        """
        return getattr(self.x if hasattr(self.x, name) else self.u, name)


ModelFunction = Callable[[Signals], None]
Hold = Literal["zero", "average", "linear"]


class ModelKind(StrEnum):
    """Kind of the modelled object. It determines how its logs are read."""

    VEHICLE = "vehicle"
    BENCH = "bench"  # a thruster on a test bench, from a log of this thruster alone
    NOISE = "noise"  # a sensor at rest, for its noise


Place = Literal["actuator", "hull", "environment", "sensor", "bench"]


@dataclass(frozen=True)
class State:
    """State of a model.

    Attributes
    ----------
    name, unit, meaning : str
        Name, unit and description.
    noise : float or str
        Diffusion in unit/sqrt(s): a number, or the name of a parameter.
    x0, sd0 : float or str
        Mean and standard deviation in `unit` at the start of a record: a number, or the name of a parameter.
    from_output : str
        Output whose first measurement is the initial mean; empty: `x0` is the initial mean.
    nuisance : bool
        Whether the state is a disturbance or a sensor offset, which a model for control does not need.
    """

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
    """Known signal that drives a model.

    Attributes
    ----------
    name, unit : str
        Name of the signal in a log, and its unit.
    hold : "zero", "average" or "linear"
        Hold between samples. ``zero``: constant, and every change starts a new row, unless the input is averaged.
        ``average``: constant, replaced between rows by a straight line of the same mean and first moment. ``linear``:
        linear interpolation.
    angle : bool
        Whether the signal is an angle [rad], which is unwrapped before it is interpolated.
    label : str or None
        Name in plots. None: `name`; empty: not plotted.
    tap_of : str
        Name of the signal of which this input is a delayed copy. Empty: it is no copy.
    tap : int
        Number of steps of the delay (negative: later). 0: the input is in the data.
    delay : float
        Delay of the copy [s].
    prefilter : bool
        Whether the input is averaged over the same time as the sensors. Inputs that forces follow at once are averaged.
        A command that a lag of the model smooths anyway, and a measured signal of a sensor, are not averaged.
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
        """Return the copy of this input that has its value of ``tap`` steps ago, named ``NAME~tap``.

        Parameters
        ----------
        tap : int
            Number of steps; negative for a later value. 0: the result is the input itself.
        step : float
            Length of a step [s], 0.1 s by default.

        Notes
        -----
        `seatrial.ident.model.delayed_inputs` describes the kinds of copies. The copy has no label, so that it is not
        plotted. A zero-order hold becomes ``average``.
        """
        if not tap:
            return self
        return replace(self, name=tap_name(self.name, tap), label="", tap_of=self.name, tap=tap, delay=step * tap).held(
            self.hold
        )

    def like(self, source: Input) -> Input:
        """Return this delayed copy with the hold and the averaging (`prefilter`) of its source."""
        return replace(self.held(source.hold), prefilter=source.prefilter)

    def held(self, hold: str) -> Input:
        """Return this input with the hold of its signal in a log, for example ``linear``.

        An empty ``hold`` (unknown) returns the input itself. Changes of a delayed copy do not start new rows, so its
        zero-order hold becomes ``average``. An input with the hold ``average`` also keeps it.
        """
        if hold == "zero" and (self.tap or self.hold == "average"):
            hold = "average"
        return replace(self, hold=hold) if hold else self  # type: ignore[arg-type]


@dataclass(frozen=True)
class Output:
    """Output of a sensor.

    Attributes
    ----------
    name, unit : str
        Name of the signal in a log, and its unit.
    noise : str
        Name of the parameter with the standard deviation of the white measurement noise.
    angle : bool
        Whether the output is an angle [rad]. Its innovations are wrapped to (-pi, pi].
    robust : bool
        Whether outliers are allowed (`seatrial.ident.model.outlier_density`).
    """

    name: str
    unit: str = ""
    noise: str = ""
    angle: bool = False
    robust: bool = False


@dataclass(frozen=True)
class Sensor:
    """Sensor whose outputs arrive together: a row has a sample of all of its outputs or of none.

    Attributes
    ----------
    name : str
        Name, for example ``gyro``.
    outputs : tuple[Output, ...]
        Outputs, at least one.
    averaged : bool
        Whether samples within the time of a row are averaged. If False, one of them is used. It is False for outputs
        that follow the inputs quickly, within the time of a row.
    """

    name: str
    outputs: tuple[Output, ...]
    averaged: bool = True


@dataclass(frozen=True)
class ForceCurve:
    """Nonparametric curve: a residual quantity as a function of one variable, or of the products of two variables.

    Attributes
    ----------
    force : str
        Name of the quantity (``DisturbanceChannel``): a force such as ``X``, or a sensor output such as ``psi``.
    variable : str
        Name of the ``Variable``, for example ``u``.
    second : str
        Second variable of the products; empty for a function of one variable.
    """

    force: str
    variable: str
    second: str = ""

    @property
    def variables(self) -> str:
        """Variables for display: ``u``, or ``u, r``."""
        return f"{self.variable}, {self.second}" if self.second else self.variable


class EffectKind(StrEnum):
    """Kind of an effect: how the diagnosis finds, names and reports it."""

    CATALOGUE = "catalogue"  # a named physical effect
    BETWEEN_RUNS = "between-runs"  # a parameter that differs between runs
    NONPARAMETRIC = "nonparametric"  # a force as a fitted function of a variable
    LAGGED = "lagged"  # a force that follows an input by a first-order lag
    RESONANT = "resonant"  # a force that follows an input by a second-order, oscillating response
    DISTURBANCE = "disturbance"  # a disturbance force, for the filter
    SENSOR_OFFSET = "sensor-offset"  # a random-walk offset or a latency of a sensor, for the filter

    @property
    def nonparametric(self) -> bool:
        """Whether no catalogue has a name for the effect: a fitted curve, or a lagged or resonant response."""
        return self in (EffectKind.NONPARAMETRIC, EffectKind.LAGGED, EffectKind.RESONANT)

    @property
    def nuisance(self) -> bool:
        """Whether the effect serves the filter only and is no property of the boat."""
        return self in (EffectKind.DISTURBANCE, EffectKind.SENSOR_OFFSET)


def curve_name(kind: EffectKind, curve: ForceCurve) -> str:
    """Return the display name of an effect without a catalogue name, for example ``X(u)`` or ``N(u, r)``.

    Parameters
    ----------
    kind : EffectKind
        A lagged response is ``X(past of n_sum)``, and a resonant response ``X(swing after n_sum)``. For any other kind,
        there are only the variables in the parentheses.
    curve : ForceCurve
        Names of the force and of its variables.
    """
    response = {EffectKind.LAGGED: "past of ", EffectKind.RESONANT: "swing after "}.get(kind, "")
    return f"{curve.force}({response}{curve.variables})"


@dataclass(frozen=True)
class Effect:
    """Extension of a model: a candidate for a missing effect, or a disturbance that the filter needs.

    With the default values of its parameters, a candidate changes nothing.

    Attributes
    ----------
    name, title : str
        Identifier, and name in reports.
    hooks : Mapping[str, ModelFunction]
        Functions by the stage, or the ``LATER`` place, after which they run. ``PARAMETERS``: before all stages.
    parameters, states, inputs : tuple
        What the effect adds to the model. Inputs that the model has already are not added again.
    place : str
        Physical origin: ``actuator``, ``hull``, ``environment``, ``sensor`` or ``bench``.
    formula, source, experiment : str
        Equation, literature, and the experiment that identifies the effect.
    requires : tuple[str, ...]
        Signals that the model must provide, for example ``f`` (thrust by thruster).
    one_sided : bool
        Whether the first parameter cannot be negative: its lower bound is 0.
    alternatives : tuple[str, ...]
        Names of competing effects that explain similar data.
    nests : tuple[str, ...]
        Names of effects that are special cases of this effect. It explains at least as much as they do.
    scan : Mapping[str, tuple[float, ...]]
        Values to try for a parameter that has no gradient while the effect is zero, by name, in the unit of the
        parameter.
    kind : EffectKind
        Kind; ``CATALOGUE`` for an effect with a name.
    curve : ForceCurve or None
        Force and variables, for an effect without a catalogue name.
    span : tuple[float, float] or None
        Range of the variable that a nonparametric effect covers, in the unit of the variable.
    parametric_form_of : ForceCurve or None
        Curve of which this effect is one parametric form among others.
    nonparametric_of : ForceCurve or None
        Curve that this effect describes by a series, without a specific form.
    fixed_point : bool
        Whether the effect acts at a point fixed over ground: all logs must share one origin.
    in_words : Callable or None
        Function of the estimates and their standard errors, by parameter, that returns a clause for reports. None: the
        parameters need no explanation.
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
    one_sided: bool = False
    alternatives: tuple[str, ...] = ()
    nests: tuple[str, ...] = ()
    scan: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    kind: EffectKind = EffectKind.CATALOGUE
    curve: ForceCurve | None = None
    span: tuple[float, float] | None = None
    parametric_form_of: ForceCurve | None = None
    nonparametric_of: ForceCurve | None = None
    fixed_point: bool = False
    in_words: Callable[[Mapping[str, tuple[float, float]]], str] | None = None

    def is_table_of(self, curve: ForceCurve | None) -> bool:
        """Return whether the effect is the nonparametric curve of this force and variable. None: return False."""
        return self.kind is EffectKind.NONPARAMETRIC and self.curve is not None and self.curve == curve


@dataclass(frozen=True)
class StartGrid:
    """Alternative initial values for a multimodal likelihood. Every combination is evaluated, and the best are fitted.

    Attributes
    ----------
    names : tuple[str, ...]
        Parameters. The first parameter distinguishes the starts.
    values : tuple[tuple[float, ...], ...]
        Values to try for each parameter.
    apart : float
        Minimum distance of two starts in the first parameter, in its unit.
    gaining : bool
        Whether to fit only starts that are more likely than the current fit, with all other parameters as fitted.
    """

    names: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    apart: float
    gaining: bool = False


@dataclass(frozen=True)
class DisturbanceChannel:
    """Quantity of a model to which an unexplained part can be added.

    The quantity is a force on the hull or on the load cell, a thrust, a rate, or a sensor output.

    Attributes
    ----------
    name, unit, title : str
        Name (``X``), unit, and text for reports.
    state : str
        Disturbance state for this quantity (`seatrial.ident.models.disturbances`). Empty: it has none.
    scale : float
        Standard deviation of the prior of a nonparametric curve of this quantity, in `unit`.
    add : Callable
        ``add(signals, extra)`` adds a value of `unit` to the quantity, after the stage `stage`.
    stage : str
        Stage or ``LATER`` place of a model, for example ``force``.
    of : tuple[str, ...]
        Variables on which the quantity may depend. Empty: all variables of the model.
    place, requires
        Properties of the nonparametric effects on the quantity, as in `Effect`.
    relative : bool
        Whether the unexplained part is a factor. Its value at zero of the variable then belongs to other parameters,
        and it has no disturbance state.
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
    """Mean or difference of the shaft speeds or thrusts of two thrusters.

    Attributes
    ----------
    quantity : "n" or "f"
        Shaft speeds (normalised) or thrusts [N].
    difference : bool
        True for left minus right, False for the mean.
    """

    quantity: Literal["n", "f"]
    difference: bool


@dataclass(frozen=True)
class Variable:
    """Variable on which a residual may depend.

    Attributes
    ----------
    name, unit : str
        Name, for example ``u``, and unit.
    read : Callable
        Returns the variable, given the signals of a row.
    angle : bool
        Whether the variable is an angle [rad], which is wrapped. Harmonics describe the residual as a function of an
        angle.
    functions : int
        Number of splines that describe the residual as a function of another variable.
    pair : ThrusterPair or None
        Thrusters of the variable: a force may follow them with a lag. None for a variable that is not of a pair of
        thrusters.
    """

    name: str
    unit: str
    read: Callable[[Signals], Any]
    angle: bool = False
    functions: int = 6
    pair: ThrusterPair | None = None


@dataclass(frozen=True)
class Model:
    """Model in continuous time: ``dx = f(x, u; p) dt + noise``, and ``y_k = h(x(t_k), u(t_k); p) + e_k``.

    Attributes
    ----------
    name : str
        Name of the structure, for example ``horizontal``.
    states, inputs, sensors, parameters : tuple
        Components, whose names must be unique.
    stages : tuple
        Pairs of a label and a function. The functions run in order and change one `Signals` object. Hooks of effects
        refer to the labels.
    provides : tuple[str, ...]
        Signals that effects may require (`Effect.requires`).
    effects : tuple[Effect, ...]
        Effects that were added.
    source : str
        Text from which ``make_model`` builds the model again: "horizontal", "FILE.py:NAME". Empty: it cannot be built
        again.
    residuals, variables, products
        For the diagnosis: unexplained quantities, the variables on which they may depend, and products of two
        variables.
    block : float
        Length [s] of the blocks of time over which scores are summed: several correlation times of residuals.
    start_grid : StartGrid or None
        Additional initial values, for a multimodal likelihood.
    kind : ModelKind
        Kind of the modelled object: vehicle, thruster on a bench, or sensor at rest.
    horizon : float
        Default horizon of predictions [s].
    disturbance : Effect or None
        Disturbance states for the filter. None: forces on the hull if the model has a hull.
    max_step : float
        Maximum time between two rows [s], for the fastest states.
    second_order : bool
        Whether the filter is of second order (`seatrial.ident.engine.ekf_graph`).
    """

    name: str
    states: tuple[State, ...]
    inputs: tuple[Input, ...]
    sensors: tuple[Sensor, ...]
    parameters: tuple[Parameter, ...]
    stages: tuple[tuple[str, ModelFunction], ...]
    provides: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = field(default=())
    source: str = ""
    residuals: tuple[DisturbanceChannel, ...] = ()
    variables: tuple[Variable, ...] = ()
    products: tuple[tuple[str, str], ...] = ()
    block: float = 5.0
    start_grid: StartGrid | None = None
    kind: ModelKind = ModelKind.VEHICLE
    horizon: float = 10.0
    disturbance: Effect | None = None
    max_step: float = 0.1
    second_order: bool = False

    def __post_init__(self) -> None:
        """Check the names of the components.

        Raises
        ------
        ValueError
            If two states, inputs, outputs or parameters have the same name, or if a noise, an initial value or a
            ``from_output`` names no component.
        """
        for kind, names in (
            ("state", [s.name for s in self.states]),
            ("input", [i.name for i in self.inputs]),
            ("output", [o.name for o in self.outputs]),
            ("parameter", [p.name for p in self.parameters]),
        ):
            repeated = sorted({n for n in names if names.count(n) > 1})
            if repeated:
                raise ValueError(f"model {self.name}: {kind} {repeated[0]} is defined twice; rename one of them")
        parameters, outputs = {p.name for p in self.parameters}, {o.name for o in self.outputs}
        for field_name, name in (
            *((f"the noise of {s.name}", s.noise) for s in self.states),
            *((f"the noise of {o.name}", o.noise) for o in self.outputs),
            *((f"x0 of the state {s.name}", s.x0) for s in self.states),
            *((f"sd0 of the state {s.name}", s.sd0) for s in self.states),
        ):
            if isinstance(name, str) and name not in parameters:
                raise ValueError(f"model {self.name}: {field_name} names no parameter: {name!r}")
        for s in self.states:
            if s.from_output and s.from_output not in outputs:
                raise ValueError(
                    f"model {self.name}: from_output of the state {s.name} names no output: "
                    f"{s.from_output!r}; there is {', '.join(sorted(outputs))}"
                )

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Outputs of all sensors, in order."""
        return tuple(o for s in self.sensors for o in s.outputs)

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name."""
        return {p.name: p.value for p in self.parameters}

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of this name.

        Raises
        ------
        KeyError
            If the model lacks it. The message lists the parameters.
        """
        for p in self.parameters:
            if p.name == name:
                return p
        raise KeyError(f"model {self.name} has no parameter {name!r}; it has {', '.join(self.values)}")

    def bag(self, x: Any, u: Any, p: Any) -> Signals:
        """Return the signals before any stage has run: states, inputs and parameters by name.

        Parameters
        ----------
        x, u, p
            Values of the states, inputs and parameters, in the order of the model: scalars, symbols or columns.

        Raises
        ------
        ValueError
            If the number of values is wrong.
        """
        return Signals(
            x=States(**dict(zip([v.name for v in self.states], x, strict=True))),
            u=Inputs(**dict(zip([v.name for v in self.inputs], u, strict=True))),
            p=Parameters(**dict(zip([v.name for v in self.parameters], p, strict=True))),
            rate={},
            y={},
        )

    def signals(self, x: Any, u: Any, p: Any) -> Signals:
        """Run all stages with the hooks of all effects, and return the signals.

        Parameters
        ----------
        x, u, p
            Values of the states, inputs and parameters, in the order of the model: scalars, symbols or columns.

        Raises
        ------
        ValueError
            If the number of values is wrong.
        """
        s = self.bag(x, u, p)
        for effect in self.effects:
            if PARAMETERS in effect.hooks:
                effect.hooks[PARAMETERS](s)
        s.again = lambda x, u, p: self._until_rates(s, x, u, p)
        for label, stage in self.stages:
            self._run_stage(label, stage, s)
        return s

    def _run_stage(self, label: str, stage: ModelFunction, s: Signals) -> None:
        """Run one stage, then the hooks of the effects at the stage and at its ``LATER`` places.

        ``label`` is the label of the stage, to which the hooks refer. The functions change the signals ``s`` in place.
        """
        stage(s)
        for place in (label, *LATER.get(label, ())):
            for effect in self.effects:
                if place in effect.hooks:
                    effect.hooks[place](s)

    def _until_rates(self, s: Signals, x: Mapping[str, Any], u: Mapping[str, Any], p: Mapping[str, Any]) -> Signals:
        """Run the stages before ``output`` on new signals, and return them. The signals ``s`` are not changed.

        ``x``, ``u`` and ``p`` have values by name that replace those of ``s``.
        """
        x, u, p = vars(s.x) | x, vars(s.u) | u, vars(s.p) | p
        changed = Signals(x=States(**x), u=Inputs(**u), p=Parameters(**p), rate={}, y={})
        for label, stage in self.stages:
            if label == "output":
                break
            self._run_stage(label, stage, changed)
        return changed

    def with_values(self, values: Mapping[str, float]) -> Model:
        """Return the model with other parameter values, by name. Parameters that are not named keep their values.

        Raises
        ------
        KeyError
            If the model has no parameter of a name.
        ValueError
            If a value is outside its bounds.
        """
        unknown = set(values) - set(self.values)
        if unknown:
            raise KeyError(
                f"model {self.name} has no parameter {sorted(unknown)[0]!r}; it has {', '.join(self.values)}"
            )
        return replace(self, parameters=tuple(p.at(values.get(p.name, p.value)) for p in self.parameters))

    def with_free(self, names: Iterable[str]) -> Model:
        """Return the model with exactly the parameters ``names`` free. All others are fixed at their values.

        Raises
        ------
        KeyError
            If the model has no parameter of a name.
        """
        wanted = set(names)
        unknown = wanted - set(self.values)
        if unknown:
            raise KeyError(
                f"model {self.name} has no parameter {sorted(unknown)[0]!r}; it has {', '.join(self.values)}"
            )
        return replace(self, parameters=tuple(replace(p, free=p.name in wanted) for p in self.parameters))

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.parameters if p.free)

    @property
    def considered(self) -> tuple[str, ...]:
        """Names of the considered parameters.

        They are not estimated, but the uncertainty of their priors adds to the errors of the estimates.
        """
        return tuple(p.name for p in self.parameters if p.considered_sd is not None)

    @property
    def noises(self) -> frozenset[str]:
        """Names of the parameters that set only covariances: standard deviations and diffusions."""
        named = [o.noise for o in self.outputs] + [s.noise for s in self.states] + [s.sd0 for s in self.states]
        return frozenset(n for n in named if isinstance(n, str))

    def role(self, name: str) -> ParameterRole:
        """Return the role of a parameter: noise or initial state by its use in the model, otherwise its declared role.

        Raises
        ------
        KeyError
            If the model lacks the parameter.
        """
        if name in self.noises:
            return ParameterRole.NOISE
        if name in {s.x0 for s in self.states}:
            return ParameterRole.INITIAL_STATE
        return self.parameter(name).role

    @property
    def noise_parameters(self) -> frozenset[str]:
        """Names of the parameters on which no prediction of the mean depends.

        These are standard deviations, diffusions, and properties of zero-mean disturbances, such as a correlation time.
        """
        disturbance = {p.name for p in self.parameters if self.role(p.name) is ParameterRole.DISTURBANCE}
        return self.noises | disturbance

    def replace_parameters(self, *new: Parameter) -> Model:
        """Return the model with the parameters ``new`` in the place of those with the same names.

        A new parameter whose name the model lacks is ignored.
        """
        by_name = {p.name: p for p in new}
        return replace(self, parameters=tuple(by_name.get(p.name, p) for p in self.parameters))

    def __add__(self, effect: Effect) -> Model:
        """Return the model with the effect added: its hooks, states, parameters, and the inputs that the model lacks.

        Raises
        ------
        ValueError
            If the model lacks a signal that the effect requires, or has a state or parameter of the same name.
        """
        missing = self._missing_signals(effect)
        if missing:
            raise ValueError(
                f"effect {effect.name} needs the signal {sorted(missing)[0]!r}, which model {self.name} does not have"
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
        """Return the model without the effect ``name``: without its hooks, states, parameters and inputs.

        Inputs that another effect reads are kept. Return an equal model if it lacks the effect.
        """
        removed = [e for e in self.effects if e.name == name]
        kept = tuple(e for e in self.effects if e.name != name)
        unused = {i.name for e in removed for i in e.inputs} - {i.name for e in kept for i in e.inputs}
        states = {s.name for e in removed for s in e.states}
        parameters = {p.name for e in removed for p in e.parameters}
        return replace(
            self,
            states=tuple(s for s in self.states if s.name not in states),
            inputs=tuple(i for i in self.inputs if i.name not in unused),
            parameters=tuple(p for p in self.parameters if p.name not in parameters),
            effects=kept,
        )

    def accepts(self, effect: Effect) -> bool:
        """Return whether the effect can be added: the model provides its signals, and has none of its names."""
        return self.refusal(effect) is None

    def refusal(self, effect: Effect) -> str | None:
        """Return the reason why the effect cannot be added, as the end of a sentence, or None if it can be added."""
        if missing := self._missing_signals(effect):
            return f"it needs the signal {min(missing)!r}, which model {self.name} does not have"
        present = {e.name for e in self.effects} | set(self.values) | {s.name for s in self.states}
        common = present & {effect.name, *(p.name for p in effect.parameters), *(s.name for s in effect.states)}
        return f"model {self.name} has {min(common)} already" if common else None

    def _missing_signals(self, effect: Effect) -> set[str]:
        """Return the signals that an effect requires and the model does not provide.

        A model that provides ``hull`` also provides ``plane``.
        """
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
    """Return a model without stages, from a function of the rates and a function of the outputs.

    Parameters
    ----------
    name : str
        Name of the model.
    f : Callable
        ``f(x, u, p)`` returns a dictionary {state: rate}, with rates per second.
    h : Callable
        ``h(x, u, p)`` returns a dictionary {output: value}.
    states, inputs, sensors, parameters
        Components of the model.
    source : str
        Text from which the model can be built again, for example "FILE.py:NAME".

    Notes
    -----
    States, inputs and parameters are attributes of ``x``, ``u`` and ``p``. They are scalars, symbols or columns. If a
    function does not return a dictionary, a TypeError is raised when the model is evaluated.
    """

    def rate(s: Signals) -> None:
        """Set the rates of the states by the user's function."""
        s.rate.update(_checked_dictionary(f(s.x, s.u, s.p), "f", "{state: rate}"))

    def output(s: Signals) -> None:
        """Set the outputs by the user's function."""
        s.y.update(_checked_dictionary(h(s.x, s.u, s.p), "h", "{output: value}"))

    for stage, own in ((rate, f), (output, h)):
        update_wrapper(stage, own)  # so that error messages name the line of the user's function
    return Model(name, states, inputs, sensors, parameters, (("rate", rate), ("output", output)), source=source)


def _checked_dictionary(found: Any, function: str, expected: str) -> Mapping[str, Any]:
    """Return the result ``found`` of the user's function, after checking that it is a dictionary.

    ``function`` is the name of the function and ``expected`` describes the dictionary, for the message.

    Raises
    ------
    TypeError
        If the function returned another type.
    """
    if not isinstance(found, Mapping):
        raise TypeError(f"{function} returns a {type(found).__name__}, not a dictionary {expected}")
    return found


def resolve_initial_states(states: Iterable[State], sensors: Iterable[Sensor]) -> tuple[State, ...]:
    """Return the states for these sensors.

    A state whose `from_output` no sensor measures starts from its `x0` instead.
    """
    measured = {o.name for s in sensors for o in s.outputs}
    return tuple(s if s.from_output in measured else replace(s, from_output="") for s in states)


class States(Named):
    """States by name."""

    _kind = "state"


class Inputs(Named):
    """Inputs by name."""

    _kind = "input"


class Parameters(Named):
    """Values of the parameters by name."""

    _kind = "parameter"
