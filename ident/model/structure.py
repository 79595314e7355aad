"""Model of a vehicle, thruster or sensor: named states, inputs, sensors and parameters, and the functions between them.

The functions are plain Python functions of scalars. They may use numpy functions, because the engine calls them with
symbols. The functions are ordered in stages. All stages read and write one `Signals` object:

    shaft -> thrust -> force -> rate -> output

An effect (an extension of a model) has functions that run after a stage; ``model + effect`` is again a model. Some
effects depend on the result of all other effects of a stage. Their functions run at one of the ``LATER`` places of the
stage, so that the order in which effects are added does not matter. User-defined models need no stages: ``plain_model``
takes ``f(x, u, p)`` and ``h(x, u, p)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, update_wrapper
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

from seatrial.ident.model.delayed_inputs import HISTORY_STEP, tap_name
from seatrial.ident.model.parameter import Parameter, ParameterRole

PARAMETERS = "parameters"  # a hook with this label changes parameters before the first stage
# Places after each stage, in order, for effects that run after all effects at the stage itself
LATER: Mapping[str, tuple[str, ...]] = {
    "thrust_lag": ("side_lag",),  # a lag of each thruster, behind the common one
    "thrust": ("thrust_loss",),  # factors on the generated thrust
    "force": ("loose_mass",),  # a moving mass that takes a part of the total force
    "rate": ("carried",),  # states that the acceleration of the boat excites
    # latency of the antenna's position fix; misaligned axes and heading errors; offsets of the sensors
    "output": ("late_fix", "axes", "reading"),
}


class Named(SimpleNamespace):
    """Values of named quantities, read as attributes.

    Each value is a scalar, a symbol, or a column (n,) over several rows.

    An unknown name raises an AttributeError that lists the available names.
    """

    _kind = "signal"

    def __getattr__(self, name: str) -> Any:  # Python calls this only for missing attributes
        """Raise AttributeError for an unknown name. The message lists the known names, or "none".

        Python calls this method only if the object has no attribute of the name.
        """
        available = ", ".join(vars(self)) or "none"
        raise AttributeError(f"no {self._kind} {name!r}; there is {available}", name=name, obj=self)


class Signals(Named):
    """Signals of a model that its functions read and write, for one row of a record, or for all rows as columns.

    Attributes
    ----------
    x, u, p : Named
        States, inputs and parameters by name.
    rate, y : dict
        Time derivatives of the states per second, and outputs, by name.
    max_step : float
        Maximum time between two rows of the model [s]: its longest integration step.
    again : Callable
        ``again(x, u, p)`` runs the model again up to the time derivatives, with other values of some states, inputs and
        parameters (dicts by name). It returns new signals, without outputs, `again` and `once`; effects that change
        parameters do not change them again. It is for effects that depend on earlier derivatives.

    once : Callable
        ``once(name, compute)`` returns ``compute()``. If the evaluation continues a recorded one (`RecordedEvaluation`)
        and has its inputs and parameters, the result is the recorded one of this name. It is for slow computations that
        depend on inputs and parameters only.

    Each model adds signals of its own. Vehicle models add shaft speeds ``n`` and thrusts ``f`` [N] by thruster, and the
    forces ``X``, ``Y`` [N] and the moment ``N`` [N m].
    """

    x: Any
    u: Any
    p: Any
    rate: dict[str, Any]
    y: dict[str, Any]
    max_step: float
    again: Callable[[Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]], Signals]
    once: Callable[[str, Callable[[], Any]], Any]

    def with_values(self, x: Mapping[str, Any], u: Mapping[str, Any], p: Mapping[str, Any]) -> Signals:
        """Return new signals before the first stage, with other values of some states, inputs and parameters by name.

        The other values are those of these signals, which are not changed.
        """
        x, u, p = vars(self.x) | x, vars(self.u) | u, vars(self.p) | p
        return Signals(x=States(**x), u=Inputs(**u), p=Parameters(**p), rate={}, y={}, max_step=self.max_step)

    def state_or_input(self, name: str) -> Any:
        """Return the value of the state ``name`` if the model has it, otherwise of the input ``name``.

        Raises
        ------
        AttributeError
            If there is neither. The message lists the inputs.
        """
        return getattr(self.x if hasattr(self.x, name) else self.u, name)


ModelFunction = Callable[[Signals], None]
Hold = Literal["zero", "average", "linear"]


class ModelKind(StrEnum):
    """Kind of the modelled object: a vehicle, a thruster on a bench, or a sensor at rest.

    It decides how logs are read.

    Attributes
    ----------
    VEHICLE
        A vehicle in motion.
    BENCH
        A thruster on a test bench, from a log of this thruster alone.
    NOISE
        A sensor at rest, for its noise.
    """

    VEHICLE = "vehicle"
    BENCH = "bench"
    NOISE = "noise"


Place = Literal["actuator", "hull", "environment", "sensor", "bench"]


@dataclass(frozen=True)
class State:
    """State of a model.

    Attributes
    ----------
    name, unit, meaning : str
        Name, unit and description.
    noise : float or str
        Diffusion of the process noise in unit/sqrt(s): a number, or the name of a parameter. 0: no process noise.
    x0, sd0 : float or str
        Mean and standard deviation in `unit` at the start of a record: a number, or the name of a parameter.
    from_output : str
        Output whose first measurement in a record is the initial mean. If it is empty, or if the record has no such
        measurement, the initial mean is that in ``Record.start``, or else `x0`.
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
        Signal between its samples. ``zero``: constant, and every change starts a new row of the record, unless the
        input is averaged (`prefilter`). ``average``: constant, but changes start no rows; in each row, a straight line
        of the same mean and first moment replaces the signal. ``linear``: linear interpolation.
    angle : bool
        Whether the signal is an angle [rad], which is unwrapped before it is interpolated.
    label : str or None
        Name in plots. None: `name`; empty: not plotted.
    tap_of : str
        Name of the signal of which this input is a delayed copy. Empty: it is no copy.
    tap : int
        Delay of the copy in steps; negative for a copy of later values. 0: the samples of the input are in the log.
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
        """Return a delayed copy of this input, named ``NAME~tap``: an input with the value of ``tap`` steps ago.

        Parameters
        ----------
        tap : int
            Delay in steps; negative for a later value. 0: the result is the input itself.
        step : float
            Length of a step [s], 0.1 s by default.

        Notes
        -----
        `seatrial.ident.model.delayed_inputs` describes the kinds of copies. The copy has no label, so that it is not
        plotted. If the hold of the input is ``zero``, that of the copy is ``average``.
        """
        if not tap:
            return self
        return replace(self, name=tap_name(self.name, tap), label="", tap_of=self.name, tap=tap, delay=step * tap).held(
            self.hold
        )

    def like(self, source: Input) -> Input:
        """Return this delayed copy with the hold and the averaging (`prefilter`) of ``source``, which it copies.

        The hold ``zero`` becomes ``average``, as in `held`.
        """
        return replace(self.held(source.hold), prefilter=source.prefilter)

    def held(self, hold: str) -> Input:
        """Return this input with the hold ``hold``, for example the one that a log states for its signal.

        Parameters
        ----------
        hold : str
            ``zero``, ``average`` or ``linear``. Empty, for an unknown hold: the result is the input itself.

        Returns
        -------
        Input
            With ``zero``, the hold becomes ``average`` for a delayed copy, whose changes start no new rows, and for an
            input whose hold was ``average``.
        """
        if hold == "zero" and (self.tap or self.hold == "average"):
            hold = "average"
        return replace(self, hold=hold) if hold else self  # type: ignore[arg-type]


@dataclass(frozen=True)
class Output:
    """Output of a model: a quantity that a sensor measures.

    Attributes
    ----------
    name, unit : str
        Name of the signal in a log, and its unit.
    noise : str
        Name of the parameter with the standard deviation of the white measurement noise. `Model` raises
        ValueError if it is empty.
    angle : bool
        Whether the output is an angle [rad]. Its innovations are wrapped to [-pi, pi).
    robust : bool
        Whether outliers are part of the density of its innovations (`seatrial.ident.model.outlier_density`).
    """

    name: str
    unit: str = ""
    noise: str = ""
    angle: bool = False
    robust: bool = False


@dataclass(frozen=True)
class Sensor:
    """Sensor whose outputs arrive together: a row of a record has samples of all of its outputs or of none.

    Attributes
    ----------
    name : str
        Name, for example ``gyro``.
    outputs : tuple[Output, ...]
        Outputs, at least one.
    averaged : bool
        Whether samples of a fast sensor are averaged over the time of a row. If False, only one sample per row is used.
        It is False for outputs that follow the inputs within the time of a row.
    """

    name: str
    outputs: tuple[Output, ...]
    averaged: bool = True


@dataclass(frozen=True)
class ForceCurve:
    """Names of a nonparametric curve: a force, or sensor error, as a function of one variable or of products of two.

    Attributes
    ----------
    force : str
        Name of the quantity (``DisturbanceChannel``): a force such as ``X``, or a sensor output such as ``psi``.
    variable : str
        Name of the ``Variable``, for example ``u``.
    second : str
        Name of the second variable of the products; empty for a function of one variable.
    """

    force: str
    variable: str
    second: str = ""

    @property
    def variables(self) -> str:
        """Names of the variables for display: ``u``, or ``u, r`` with a second variable."""
        return f"{self.variable}, {self.second}" if self.second else self.variable


class EffectKind(StrEnum):
    """Kind of an effect. The diagnosis finds, names and reports each kind differently.

    Attributes
    ----------
    CATALOGUE
        A named physical effect.
    BETWEEN_RUNS
        A parameter that differs between runs.
    NONPARAMETRIC
        A force as a fitted function of a variable.
    LAGGED
        A force that follows an input by a first-order lag.
    RESONANT
        A force that follows an input by a second-order, oscillating response.
    DISTURBANCE
        A disturbance force, for the filter.
    SENSOR_OFFSET
        A random-walk offset or a latency of a sensor, for the filter.
    """

    CATALOGUE = "catalogue"
    BETWEEN_RUNS = "between-runs"
    NONPARAMETRIC = "nonparametric"
    LAGGED = "lagged"
    RESONANT = "resonant"
    DISTURBANCE = "disturbance"
    SENSOR_OFFSET = "sensor-offset"

    @property
    def nonparametric(self) -> bool:
        """Whether the effect has no name in the catalogue: it is a fitted curve, or a lagged or resonant response."""
        return self in (EffectKind.NONPARAMETRIC, EffectKind.LAGGED, EffectKind.RESONANT)

    @property
    def nuisance(self) -> bool:
        """Whether the effect serves only the filter and is no property of the boat.

        It is then a disturbance or a sensor offset.
        """
        return self in (EffectKind.DISTURBANCE, EffectKind.SENSOR_OFFSET)


def curve_name(kind: EffectKind, curve: ForceCurve) -> str:
    """Return the display name of an effect without a catalogue name, for example ``X(u)`` or ``N(u, r)``.

    Parameters
    ----------
    kind : EffectKind
        Kind of the effect. The name of a lagged response is ``X(past of n_sum)``, that of a resonant response ``X(swing
        after n_sum)``, and that of any other kind ``X(n_sum)``.
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
        Functions that change the signals, by the stage or the ``LATER`` place after which they run. The ``LATER``
        places of a stage, such as ``thrust_loss``, come in a fixed order after all functions at the stage itself. With
        the key ``PARAMETERS``, the function runs before all stages.
    parameters, states, inputs : tuple
        Components that the effect adds to the model. Inputs that the model already has are not added again.
    place : str
        Physical origin: ``actuator``, ``hull``, ``environment``, ``sensor`` or ``bench``.
    formula, source, experiment : str
        Equation, literature, and the experiment that identifies the effect.
    causes : str
        What to look for on the craft and around it: parts or conditions that have this effect, separated by commas.
        Empty if the title says it.
    requires : tuple[str, ...]
        Signals that the model must provide, for example ``f`` (thrust by thruster).
    one_sided : bool
        Whether the first parameter cannot be negative: its lower bound is 0.
    cannot_be_negative : Mapping[str, str]
        Parameters without a bound whose negative values contradict the title, such as a resistance that would push, by
        name, with the name of the effect that has a similar form and both signs. A fit that finds a negative value
        shows that something else acts: no name of such an effect is certain.
    alternatives : tuple[str, ...]
        Names of competing effects that explain similar data.
    separated_by : Mapping[str, str]
        Competing effects that a mission of thruster commands may not distinguish from this one, however long it is,
        because one can imitate the other. The keys are their names, the values clauses that say what distinguishes
        them. One of both effects has the entry.
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
        Whether the effect acts at a point that is fixed over ground, so that all logs must have the same origin of
        position.
    in_words : Callable or None
        Function that returns a clause for reports, given (estimate, standard error) by parameter of the model. None:
        the parameters need no explanation.
    in_words_of_data : Callable or None
        Function that returns a clause in place of ``in_words`` where the data are known. It has a second argument: the
        last value of each input in each estimation record, by input of the model. None: ``in_words`` needs no data.
    thrust_difference : str
        Name of the parameter that is half the relative difference of the thrust of both sides, left minus right. The
        data determine the difference, but not which side differs from its given curve. Empty: the effect has no such
        parameter.
    refuted_by : Callable or None
        Function that returns a clause for reports, why signals contradict the effect that the model does not use, given
        the channels of each run by name; empty if they do not. A diagnosis does not test a contradicted effect. None:
        no signal can contradict it.
    takes_over : tuple[str, ...]
        Names of parameters of the model that describe the same physics in another form. Their estimate of zero beside
        this effect needs no action.
    at_lower_bound : Mapping[str, str]
        What an estimate at the lower bound means and what to do, by name of the parameter: a clause for reports.
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
    causes: str = ""
    requires: tuple[str, ...] = ()
    one_sided: bool = False
    cannot_be_negative: Mapping[str, str] = field(default_factory=dict)
    alternatives: tuple[str, ...] = ()
    separated_by: Mapping[str, str] = field(default_factory=dict)
    nests: tuple[str, ...] = ()
    scan: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    kind: EffectKind = EffectKind.CATALOGUE
    curve: ForceCurve | None = None
    span: tuple[float, float] | None = None
    parametric_form_of: ForceCurve | None = None
    nonparametric_of: ForceCurve | None = None
    fixed_point: bool = False
    in_words: Callable[[Mapping[str, tuple[float, float]]], str] | None = None
    in_words_of_data: Callable[[Mapping[str, tuple[float, float]], Mapping[str, Sequence[float]]], str] | None = None
    thrust_difference: str = ""
    refuted_by: Callable[[Sequence[Mapping[str, Any]]], str] | None = None
    takes_over: tuple[str, ...] = ()
    at_lower_bound: Mapping[str, str] = field(default_factory=dict)

    def is_table_of(self, curve: ForceCurve | None) -> bool:
        """Return whether this effect is the nonparametric curve of the force and variables of ``curve``.

        False for None, and for any effect of another kind, also a lagged or resonant response of the same names.
        """
        return self.kind is EffectKind.NONPARAMETRIC and self.curve is not None and self.curve == curve


@dataclass(frozen=True)
class StartGrid:
    """Alternative initial values of parameters, for a likelihood with several maxima.

    The log-likelihood is computed for every combination of the values. Fits start from at most two of the most likely
    ones, besides the initial values of the model.

    Attributes
    ----------
    names : tuple[str, ...]
        Names of the parameters.
    values : tuple[tuple[float, ...], ...]
        Values to try for each parameter, in its unit.
    apart : float
        Distance in the first parameter, in its unit. Fits start from values of this parameter that differ from each
        other, and from the estimate of the first fit, by more than 1.5 times as much.
    gaining : bool
        Whether to fit only starts whose log-likelihood exceeds that of the first fit by more than 2. All other
        parameters are as in the first fit.
    """

    names: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    apart: float
    gaining: bool = False


@dataclass(frozen=True)
class DisturbanceChannel:
    """Quantity of a model to which an unexplained part can be added: where an effect may be missing in the model.

    The quantity is a force on the hull or on the load cell, a thrust, a time derivative, or a sensor output.

    Attributes
    ----------
    name, unit, title : str
        Name (``X``), unit, and text for reports.
    state : str
        Name of the disturbance state for this quantity (`seatrial.ident.models.disturbances`). Empty: it has none.
    scale : float
        Standard deviation of the prior of a nonparametric curve of this quantity, in `unit`.
    add : Callable
        ``add(signals, extra)`` adds ``extra``, in `unit`, to the quantity. For a `relative` quantity it multiplies it
        by ``1 + extra``.
    stage : str
        Stage of the model after which `add` is called, for example ``force``; or a ``LATER`` place of a stage, which
        comes after all effects at the stage itself.
    of : tuple[str, ...]
        Names of the variables on which the unexplained part may depend. Empty: all variables of the model.
    place, requires
        Physical origin, and signals that the model must provide, of the nonparametric effects on the quantity, as in
        `Effect`.
    relative : bool
        Whether the unexplained part is a relative change of the quantity. Other parameters then describe its value
        where the variable is zero, and it has no disturbance state.
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
    """Variable on which a force or sensor error that the model lacks may depend, for example the surge speed ``u``.

    Attributes
    ----------
    name, unit : str
        Name, for example ``u``, and unit.
    read : Callable
        Function that returns the value of the variable, given the `Signals` of the model.
    angle : bool
        Whether the variable is an angle [rad], which is wrapped. A function of an angle is described by harmonics, any
        other by splines.
    functions : int
        Number of B-splines, one of which is left out, that describe a function of the variable when the diagnosis
        scores candidates. It is not used for an angle.
    pair : ThrusterPair or None
        Shaft speeds or thrusts whose mean or difference the variable is: a force may follow them with a lag. None for
        any other variable.
    """

    name: str
    unit: str
    read: Callable[[Signals], Any]
    angle: bool = False
    functions: int = 6
    pair: ThrusterPair | None = None


class EffectPrior(NamedTuple):
    """Prior of a parameter of an effect, from the numbers of the boat.

    Attributes
    ----------
    name : str
        Name of the parameter.
    mean, sd : float
        Mean and standard deviation of the prior, in the unit of the parameter.
    source : str
        Where the mean was given, in words, for the meaning of the parameter in reports.
    """

    name: str
    mean: float
    sd: float
    source: str


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
        Names of the signals that effects may require (`Effect.requires`).
    effects : tuple[Effect, ...]
        Effects that were added.
    source : str
        Text from which ``make_model`` builds the model again: "horizontal", "FILE.py:NAME". Empty: it cannot be built
        again.
    residuals : tuple[DisturbanceChannel, ...]
        Quantities in which the diagnosis looks for missing effects. Empty: the forces of the hull, if the model has
        one.
    variables : tuple[Variable, ...]
        Variables on which missing effects may depend. Empty: motion, time and thrusters, if the model has a hull.
    products : tuple
        Pairs of names of variables on whose product missing effects may depend. Empty: those of u, v and r for a hull.
    block : float
        Length [s] of the blocks of time over which the diagnosis sums scores (derivatives of the log-likelihood). It
        should be several correlation times of the residuals.
    start_grid : StartGrid or None
        Additional initial values, for a multimodal likelihood.
    kind : ModelKind
        Kind of the modelled object: vehicle, thruster on a bench, or sensor at rest.
    horizon : float
        Default horizon of predictions [s].
    disturbance : Effect or None
        Disturbance states for the filter. None: disturbance forces in surge, sway and yaw, as far as the model has such
        forces (`seatrial.ident.models.disturbances.forces_of`).
    max_step : float
        Maximum time between two rows [s], for the fastest states.
    second_order : bool
        Whether the filter is of second order (`seatrial.ident.engine.ekf_graph`).
    effect_priors : tuple[EffectPrior, ...]
        Priors of parameters of effects that this boat may have, in place of those of the catalogue
        (`seatrial.ident.models.scaling.effect_for`).
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
    effect_priors: tuple[EffectPrior, ...] = ()

    def __post_init__(self) -> None:
        """Check the names of the components.

        Raises
        ------
        ValueError
            If two states, inputs, outputs or parameters have the same name. Also if a noise or an initial value is the
            name of a parameter that the model lacks (an empty name too), or a ``from_output`` the name of an output
            that it lacks.
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
                raise ValueError(
                    f"model {self.name}: {field_name} is {name!r}, which is not a parameter of the model; correct the "
                    "name, or define the parameter"
                )
        for s in self.states:
            if s.from_output and s.from_output not in outputs:
                raise ValueError(
                    f"model {self.name}: from_output of the state {s.name} is {s.from_output!r}, which is not an "
                    f"output of the model; there is {', '.join(sorted(outputs))}"
                )

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Outputs of all sensors, in the order of the sensors."""
        return tuple(o for s in self.sensors for o in s.outputs)

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters by name, in their units and in the order of the model. The dict is a new one."""
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
        """Return the signals of the model before any stage has run: only states, inputs and parameters, by name.

        Parameters
        ----------
        x, u, p
            Values of the states, inputs and parameters, in the order of the model: scalars, symbols or columns.

        Raises
        ------
        ValueError
            If the number of values is wrong.
        """
        states, inputs, parameters = self._names
        return Signals(
            x=States(**dict(zip(states, x, strict=True))),
            u=Inputs(**dict(zip(inputs, u, strict=True))),
            p=Parameters(**dict(zip(parameters, p, strict=True))),
            rate={},
            y={},
            max_step=self.max_step,
        )

    @cached_property
    def _names(self) -> tuple[tuple[str, ...], ...]:
        """Names of the states, of the inputs and of the parameters. A simulation needs them in each step."""
        return tuple(tuple(v.name for v in part) for part in (self.states, self.inputs, self.parameters))

    def signals(self, x: Any, u: Any, p: Any) -> Signals:
        """Evaluate the model: run all stages with the hooks of all effects, and return the signals.

        Parameters
        ----------
        x, u, p
            Values of the states, inputs and parameters, in the order of the model: scalars, symbols or columns.

        Returns
        -------
        Signals
            All signals, with the time derivatives of the states in ``rate`` and the outputs in ``y``.

        Raises
        ------
        ValueError
            If the number of values is wrong.
        """
        s = self.initial_signals(x, u, p)
        self.run_stages(s)
        return s

    def rates(self, x: Any, u: Any, p: Any) -> dict[str, Any]:
        """Evaluate the model up to the stage ``output``, and return the time derivatives of the states by name.

        The arguments are those of `signals`, which takes longer. The derivative of a state is missing if the stage
        ``output`` computes it.
        """
        s = self.initial_signals(x, u, p)
        self.run_stages(s, until_output=True)
        return s.rate

    def initial_signals(self, x: Any, u: Any, p: Any) -> Signals:
        """Return the signals before the first stage, with the parameters changed by the hooks of the effects.

        The arguments are those of `signals`.
        """
        s = self.bag(x, u, p)
        for effect in self.effects:
            if PARAMETERS in effect.hooks:
                effect.hooks[PARAMETERS](s)

        def again(x: Mapping[str, Any], u: Mapping[str, Any], p: Mapping[str, Any]) -> Signals:
            """Run the model up to the time derivatives with other values (`Signals.again`)."""
            changed = s.with_values(x, u, p)
            self.run_stages(changed, until_output=True)
            return changed

        s.again, s.once = again, lambda name, compute: compute()
        return s

    @cached_property
    def places(self) -> tuple[str, ...]:
        """Places after which functions of effects run, in order: each stage, followed by its ``LATER`` places."""
        return tuple(place for label, _ in self.stages for place in (label, *LATER.get(label, ())))

    def run_stages(
        self,
        s: Signals,
        *,
        until_output: bool = False,
        continued_at: int | None = None,
        after_each: Callable[[], None] | None = None,
    ) -> None:
        """Run the stages, each followed by the hooks of all effects at its `places`. ``s`` is changed in place.

        At each place, the hooks run in the order in which the effects were added.

        Parameters
        ----------
        s : Signals
            Signals before the first stage, or those at ``continued_at``.
        until_output : bool
            Whether to stop before the stage ``output``.
        continued_at : int, optional
            Index of the place up to which everything has run, except for the hook of the last effect at this place.
        after_each : Callable, optional
            Function that is called after each place.
        """
        index = -1
        for label, stage in self.stages:
            if until_output and label == "output":
                return
            for place in (label, *LATER.get(label, ())):
                index += 1
                effects = self.effects
                if continued_at is not None and index <= continued_at:
                    effects = effects[-1:] if index == continued_at else ()
                elif place == label:
                    stage(s)
                for effect in effects:
                    if place in effect.hooks:
                        effect.hooks[place](s)
                if after_each is not None:
                    after_each()

    def with_values(self, values: Mapping[str, float]) -> Model:
        """Return the model with other parameter values, by name. Parameters that are not named keep their values.

        Raises
        ------
        KeyError
            If the model lacks a named parameter. The message lists its parameters.
        ValueError
            If a value is outside its bounds, or not positive for a parameter with the transform "log".
        """
        unknown = set(values) - set(self.values)
        if unknown:
            raise KeyError(
                f"model {self.name} has no parameter {sorted(unknown)[0]!r}; it has {', '.join(self.values)}"
            )
        return replace(self, parameters=tuple(p.at(values.get(p.name, p.value)) for p in self.parameters))

    def with_free(self, names: Iterable[str]) -> Model:
        """Return the model in which exactly the parameters ``names`` are estimated.

        All others are fixed at their values; a considered parameter among them still counts as considered.

        Raises
        ------
        KeyError
            If the model lacks a named parameter. The message lists its parameters.
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
        """Names of the parameters that are estimated, in the order of the model."""
        return tuple(p.name for p in self.parameters if p.free)

    @property
    def considered(self) -> tuple[str, ...]:
        """Names of the considered parameters, in the order of the model.

        They are not estimated, but the uncertainty of their priors adds to the errors of the estimates. A parameter
        that is free is not among them, even if it is marked as considered.
        """
        return tuple(p.name for p in self.parameters if p.considered_sd is not None)

    @property
    def noises(self) -> frozenset[str]:
        """Names of the parameters that set only covariances.

        These are standard deviations of measurements and of initial states, and diffusions.
        """
        named = [o.noise for o in self.outputs] + [s.noise for s in self.states] + [s.sd0 for s in self.states]
        return frozenset(n for n in named if isinstance(n, str))

    def role(self, name: str) -> ParameterRole:
        """Return the role of the parameter ``name``.

        The role is noise if the parameter is a standard deviation or a diffusion of the model, also that of an initial
        state. Else it is initial state if the parameter is an initial mean, otherwise the role that it declares.

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
        """Names of the parameters on which a simulation without noise does not depend.

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

        A delayed copy among these inputs gets the hold and the averaging of the model's input that it copies. The name
        of the effect is not checked: `refusal` reports an effect that was added already.

        Raises
        ------
        ValueError
            If the model lacks a signal that the effect requires, or has a state or parameter of the same name.
        """
        missing = self._missing_signals(effect)
        if missing:
            raise ValueError(
                f"effect {effect.name} needs the signal {sorted(missing)[0]!r}, which model {self.name} does not have; "
                "use another model, or leave the effect out"
            )
        own = {i.name: i for i in self.inputs}
        return replace(
            self,
            states=self.states + effect.states,
            inputs=self.inputs
            + tuple(i.like(own[i.tap_of]) if i.tap_of in own else i for i in effect.inputs if i.name not in own),
            parameters=self.parameters + tuple(map(self._resolved_by_steps, effect.parameters)),
            effects=(*self.effects, effect),
        )

    def _resolved_by_steps(self, p: Parameter) -> Parameter:
        """Return the parameter of an effect; a frequency of a vehicle gets an upper bound, if it has none below it.

        The bound is a quarter of the rate of the longest integration steps. At a faster oscillation, Runge-Kutta steps
        would add damping, and the covariance would grow without limit.
        """
        highest = 0.25 / self.max_step
        if p.unit != "Hz" or self.kind is not ModelKind.VEHICLE or p.bounds[1] <= highest:
            return p
        return replace(p, value=min(p.value, highest), bounds=(min(p.bounds[0], highest), highest))

    def without(self, name: str) -> Model:
        """Return the model without the effect ``name``: without its hooks, states, parameters and inputs.

        Inputs that another effect reads are kept. An input of the effect is also removed if the model had it before.
        Return an equal model if no effect of this name was added.
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
        """Return whether the effect can be added to the model (`refusal` states the conditions)."""
        return self.refusal(effect) is None

    def refusal(self, effect: Effect) -> str | None:
        """Return the reason why the effect cannot be added, as the end of a sentence, or None if it can be added.

        It cannot be added if the model lacks a signal that it requires. It cannot be added either if the name of the
        effect, of a parameter or of a state of the effect exists already in the model.
        """
        if missing := self._missing_signals(effect):
            return f"it needs the signal {min(missing)!r}, which model {self.name} does not have"
        present = {e.name for e in self.effects} | set(self.values) | {s.name for s in self.states}
        common = present & {effect.name, *(p.name for p in effect.parameters), *(s.name for s in effect.states)}
        return f"model {self.name} has {min(common)} already" if common else None

    def _missing_signals(self, effect: Effect) -> set[str]:
        """Return the signals that an effect requires and the model does not provide; empty if it provides all.

        A model that provides ``hull`` (motion with sway and yaw) also provides ``plane`` (position and velocity).
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
    """Return a model of only two stages, from a function of the time derivatives and a function of the outputs.

    The stages are ``rate`` and ``output``. Only effects that require no signal can be added to the model.

    Parameters
    ----------
    name : str
        Name of the model.
    f : Callable
        ``f(x, u, p)`` returns a dictionary {state: time derivative}, per second.
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
        """Set the time derivatives ``s.rate`` of the states by the user's function ``f``.

        Raise TypeError if ``f`` does not return a dictionary.
        """
        s.rate.update(_checked_dictionary(f(s.x, s.u, s.p), "f", "{state: rate}"))

    def output(s: Signals) -> None:
        """Set the outputs ``s.y`` by the user's function ``h``.

        Raise TypeError if ``h`` does not return a dictionary.
        """
        s.y.update(_checked_dictionary(h(s.x, s.u, s.p), "h", "{output: value}"))

    for stage, own in ((rate, f), (output, h)):
        update_wrapper(stage, own)  # so that error messages name the line of the user's function
    return Model(name, states, inputs, sensors, parameters, (("rate", rate), ("output", output)), source=source)


def _checked_dictionary(found: Any, function: str, expected: str) -> Mapping[str, Any]:
    """Return the result ``found`` of a user's function, after checking that it is a dictionary.

    ``function`` is the name of the function, and ``expected`` describes the dictionary; both are for the message.

    Raises
    ------
    TypeError
        If the result is not a dictionary (Mapping).
    """
    if not isinstance(found, Mapping):
        raise TypeError(
            f"{function} returns a {type(found).__name__}, not a dictionary {expected}; return such a dictionary"
        )
    return found


def resolve_initial_states(states: Iterable[State], sensors: Iterable[Sensor]) -> tuple[State, ...]:
    """Return the states of a model that has only the given sensors.

    A state starts from the first measurement of its output ``from_output``. If no sensor has this output,
    ``from_output`` is cleared, so that the state starts from its ``x0``.
    """
    measured = {o.name for s in sensors for o in s.outputs}
    return tuple(s if s.from_output in measured else replace(s, from_output="") for s in states)


class States(Named):
    """States of a model by name, read as attributes. An unknown name raises an AttributeError that lists the states."""

    _kind = "state"


class Inputs(Named):
    """Inputs of a model by name, read as attributes. An unknown name raises an AttributeError that lists the inputs."""

    _kind = "input"


class Parameters(Named):
    """Values of the parameters of a model by name, read as attributes.

    An unknown name raises an AttributeError that lists the parameters.
    """

    _kind = "parameter"
