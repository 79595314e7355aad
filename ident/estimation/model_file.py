"""Reader and writer of model.toml, the file of a fitted model, which docs/formats/model.md describes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomlkit

from seatrial.daq.config import parse_toml, read_text
from seatrial.daq.errors import SeatrialError, warn
from seatrial.daq.files import write_output
from seatrial.daq.log import is_log
from seatrial.ident.data import FrameOrigin
from seatrial.ident.effects import catalogue, input_response_effects, nonparametric_effect
from seatrial.ident.estimation.given_priors import agrees_with_bench, given_prior_flags
from seatrial.ident.estimation.homogeneity import BETWEEN, between_runs_effect
from seatrial.ident.estimation.interval_widening import ErrorScale, IntervalCalibration
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.estimation.parameter_covariance import ParameterCovariance
from seatrial.ident.estimation.refitted_effect import RefittedEffect
from seatrial.ident.estimation.thrust_scale import thrust_scale_of
from seatrial.ident.model import (
    Effect,
    EffectKind,
    ForceCurve,
    Model,
    ModelKind,
    Parameter,
    ParameterOrigin,
    State,
    robust_sensors,
    with_outlier_model,
)
from seatrial.ident.models import (
    ANTENNA,
    BUILT_IN,
    CURRENT_WALK,
    ESTIMATOR_ERROR,
    TELEMETRY_AGE,
    THRUST_CALIBRATION,
    VesselScale,
    antenna_component,
    catalogue_model,
    current_walk,
    disturbance_of,
    estimator_error,
    file_digest,
    is_own_model,
    load_effects,
    own_model,
    remember_trusted_file,
    scale_priors,
    sensor_bias,
    size_of,
    telemetry_age,
    thrust_calibration,
    trusted_file,
)
from seatrial.ident.numerics import Array

VALIDITY_MARGIN = 0.1  # of the width of a range of validity, by which signals may leave it without a warning
FORMAT = "seatrial-model 1"
MODEL, RESULT = "model.toml", "result.json"  # files of a fit
NOTABLE_INFLATION = 1.001  # a smaller factor by which residuals increase a standard error is rounding: not written
STATE_NUMBERS = ("sd0", "noise")  # attributes of a state that are written if they are numbers, not parameter names


@dataclass(frozen=True)
class FittedData:
    """Facts about the data that a model was fitted to, for model.toml.

    Attributes
    ----------
    validity
        Least and largest value of each signal, by name, in SI units.
    rates
        By sensor, its sample rate [Hz]; after averaging, the rate of the averages.
    origin
        Origin of x and y in the logs; None if it is unknown. It is written only for a model with a fixed point.
    intervals
        Scales of the errors on the validation data; None if there were none.
    rpm_max
        Shaft speed [rev/min] at n = 1, of a thruster; None if it is unknown.
    """

    validity: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    origin: FrameOrigin | None = None
    intervals: IntervalCalibration | None = None
    rpm_max: float | None = None


@dataclass(frozen=True)
class SavedModel:
    """Model read from a model.toml, with the uncertainty of its estimates.

    Attributes
    ----------
    model
        Model with the values of the file.
    errors
        Standard errors by parameter, in the parameters' units; NaN if there is none. For a per-record parameter, it is
        that of its mean over the records.
    validity
        Least and largest value of each signal in the fitted data, by name, in SI units.
    provenance
        Software version, command line, logs and their hashes.
    names
        Full names of the n estimates (``V_x@0`` for the value of record 0).
    correlation : Array (n, n)
        Correlation of the estimates, in the order of `names`; zero if unknown.
    effects_file
        Python file with user-defined effects; None if there is none.
    reml
        Whether the noise is estimated by restricted maximum likelihood.
    calibration
        Relative standard uncertainty of the measured forces in the fitted data; None if unknown.
    origin
        Origin of x and y for the model's fixed points; None if it has no fixed point, or if the origin is unknown.
    inflation
        By parameter, the factor by which correlated residuals increased its standard error; no entry for a factor of
        about one, or for a per-record parameter.
    rates
        By sensor, its sample rate in the fitted data [Hz].
    holds
        By input, its interpolation between samples in the fitted data (`Input.hold`). Empty if unknown, as in files of
        earlier versions.
    refits
        Effects that a diagnosis tried, in the order of its fits. Empty for a model that was not diagnosed, and in files
        of earlier versions.
    intervals
        Scales of the errors on the validation data, by which prediction intervals are widened. None without validation
        data, and in files of earlier versions.
    converged
        Whether the fit converged. True in files of earlier versions, which do not say it.
    flags
        By parameter, what is wrong with its estimate; no entry for one in order.
    rpm_max
        Shaft speed [rev/min] at n = 1, of a thruster; None if it is unknown, as in files of earlier versions.
    """

    model: Model
    errors: Mapping[str, float]
    validity: Mapping[str, tuple[float, float]]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    correlation: Array = field(default_factory=lambda: np.zeros((0, 0)))
    effects_file: Path | None = None
    reml: bool = False
    calibration: float | None = None
    origin: FrameOrigin | None = None
    inflation: Mapping[str, float] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)
    holds: Mapping[str, str] = field(default_factory=dict)
    refits: tuple[RefittedEffect, ...] = ()
    intervals: IntervalCalibration | None = None
    converged: bool = True
    flags: Mapping[str, str] = field(default_factory=dict)
    rpm_max: float | None = None

    @property
    def python_files(self) -> tuple[Path, ...]:
        """Python files of the user that the model needs: that of its structure, and that of its effects."""
        source = self.model.source
        structure = (Path(source.rpartition(":")[0]),) if is_own_model(source) else ()
        return structure + (() if self.effects_file is None else (self.effects_file,))

    def uncertainty(self, name: str) -> float:
        """Return the standard uncertainty [N] of the thrust coefficient ``name``; NaN if it has no standard error.

        It is the root of the sum of squares of the standard error of the estimate and the uncertainty of the load
        cell's calibration. An unknown name raises KeyError.
        """
        return float(np.hypot(self.errors[name], (self.calibration or 0.0) * self.model.parameter(name).value))

    def covariance(self, wanted: Collection[str] | None = None) -> ParameterCovariance:
        """Return the covariance of all estimates, or of those whose full names are in ``wanted``.

        The covariance is in the parameters' units, and in the order of the file. Estimates without a standard error are
        left out, and so are per-record parameters, of which the file has no standard error for each record. A name that
        the file lacks is ignored.
        """
        names = self.names if wanted is None else [n for n in self.names if n in wanted]
        known = tuple(n for n in names if np.isfinite(self.errors.get(n, np.nan)) and self.errors[n] > 0.0)
        at = [self.names.index(n) for n in known]
        se = np.array([self.errors[n] for n in known])
        return ParameterCovariance(known, self.correlation[np.ix_(at, at)] * np.outer(se, se))


def save_model(
    path: Path,
    fit: Fit,
    *,
    data: FittedData,
    provenance: Mapping[str, Any],
    effects_file: Path | None = None,
    calibration: float | None = None,
    refits: Sequence[RefittedEffect] = (),
) -> None:
    """Write the model of a fit to a model.toml, and beside it a copy of each user-defined Python file that it needs.

    An existing model.toml is replaced. `load_model` may run the copies without a question, because the user has run the
    same code in the fit.

    Parameters
    ----------
    path
        Path of the model.toml to be written.
    fit
        Fit whose estimates, standard errors and correlations are written.
    data
        Ranges of the signals in the fitted data, rates of the sensors, origin of x and y, and scales of the errors on
        the validation data.
    provenance
        Software version, command line, logs and their hashes. Entries that are None are left out.
    effects_file
        Python file with user-defined effects; None if there is none.
    calibration
        Relative standard uncertainty of the measured forces; None if unknown.
    refits
        Effects that a diagnosis tried, with their estimates.
    """
    model, document = fit.model, tomlkit.document()
    document["format"] = FORMAT
    document["name"] = model.name
    file, _, own = model.source.rpartition(":")
    if is_own_model(model.source) and Path(file).is_file():
        beside = _copy_beside_model(path, Path(file))
        document["source"], document["source_sha256"] = f"{beside.name}:{own}", file_digest(beside)
    else:
        document["source"] = model.source
    document["sensors"] = [s.name for s in model.sensors]
    document["effects"] = [e.name for e in model.effects]
    if robust_sensors(model):
        document["robust"] = list(robust_sensors(model))
    if model.second_order:
        document["second_order"] = True
    if fit.options.reml:
        document["reml"] = True
    if not fit.converged:
        document["converged"] = False
    unlisted = {e.name: _curve_table(e) for e in model.effects if e.kind.nonparametric}
    if unlisted:
        document["curves"] = unlisted
    if effects_file is not None:
        beside = _copy_beside_model(path, effects_file)
        document["effects_file"], document["effects_sha256"] = beside.name, file_digest(beside)
    document["provenance"] = {k: v for k, v in provenance.items() if v is not None}
    if (scale := _scale_table(model, calibration, data.rpm_max)) is not None:
        document["scale"] = scale
    if data.origin is not None and any(e.fixed_point for e in model.effects):
        document["origin"] = msgspec.structs.asdict(data.origin)
    document["validity"] = {k: [float(a), float(b)] for k, (a, b) in data.validity.items()}
    if data.rates:
        document["rates"] = {k: float(f"{z:.4g}") for k, z in data.rates.items()}
    if holds := {i.name: i.hold for i in model.inputs if i.hold and not i.tap_of}:
        document["holds"] = holds
    if states := _states_table(model, effects_file):
        document["states"] = states
    # Each fit scales the priors of disturbance forces to the size of the boat (seatrial.ident.models.scaling). A prior
    # that is written with that size would be scaled twice.
    scaled_by_fits = {p.name for e in model.effects if e.kind is EffectKind.DISTURBANCE for p in e.parameters}
    parameters = tomlkit.aot()
    for p in model.parameters:
        table = tomlkit.table()
        table.update(_parameter_table(p, fit, with_prior=p.name not in scaled_by_fits))
        parameters.append(table)
    document["parameter"] = parameters
    document["correlation"] = {"names": list(fit.names), "matrix": np.round(np.nan_to_num(fit.correlation), 6).tolist()}
    if refits:
        document["refit"] = _refit_tables(refits)
    if data.intervals is not None:
        document["intervals"] = _intervals_table(data.intervals)
    write_output(path, tomlkit.dumps(document))


def _refit_tables(refits: Sequence[RefittedEffect]) -> Any:
    """Return the tables ``refit`` of model.toml: an array of one table for each effect that a diagnosis tried."""
    tables = tomlkit.aot()
    for r in refits:
        table = tomlkit.table()
        table.update({"effect": r.name, "beside": list(r.beside)})
        for key, numbers in (("values", r.values), ("errors", r.errors)):
            inline = tomlkit.inline_table()
            inline.update({name: float(f"{z:.6g}") for name, z in numbers.items()})
            table[key] = inline
        tables.append(table)
    return tables


def _refits_from_tables(rows: Sequence[Mapping[str, Any]]) -> tuple[RefittedEffect, ...]:
    """Return the effects that a diagnosis tried, from the tables ``refit`` of model.toml."""
    found = []
    for row in rows:
        values, errors = ({str(n): float(z) for n, z in row.get(key, {}).items()} for key in ("values", "errors"))
        found.append(RefittedEffect(str(row["effect"]), tuple(str(n) for n in row["beside"]), values, errors))
    return tuple(found)


def _intervals_table(intervals: IntervalCalibration) -> Any:
    """Return the table ``intervals`` of model.toml: scales of the errors on validation data, by kind and channel."""
    table = tomlkit.table()
    table["horizon"] = float(intervals.horizon)
    for kind, scales in (("ahead", intervals.ahead), ("simulation", intervals.simulation)):
        by_channel = tomlkit.table()
        for name, found in scales.items():
            row = tomlkit.inline_table()
            row.update({"scale": float(f"{found.scale:.6g}"), "n_effective": float(f"{found.n_effective:.6g}")})
            row["n_records"] = found.n_records
            by_channel[name] = row
        table[kind] = by_channel
    return table


def _intervals_from_table(table: Mapping[str, Any] | None) -> IntervalCalibration | None:
    """Return the scales of the errors on validation data from the table ``intervals`` of model.toml; None without it.

    Raises
    ------
    ValueError
        If a number is out of range: a negative scale, or fewer than one record.
    """
    if table is None:
        return None
    ahead, simulation = (
        {name: ErrorScale(float(row["scale"]), float(row["n_effective"]), int(row["n_records"]))
         for name, row in table.get(kind, {}).items()}
        for kind in ("ahead", "simulation")
    )  # fmt: skip
    for name, found in [*ahead.items(), *simulation.items()]:
        if not (found.scale >= 0.0 and found.n_effective > 0.0 and found.n_records >= 1):
            raise ValueError(f"intervals: {name} needs a scale of 0 or more, and at least one error and one record")
    horizon = float(table["horizon"])
    if not 0.0 < horizon < np.inf:
        raise ValueError(f"intervals: horizon = {horizon:g}; it must be finite and above 0 s")
    return IntervalCalibration(horizon, ahead, simulation)


def _states_table(model: Model, effects_file: Path | None) -> dict[str, dict[str, float]]:
    """Return the table ``states`` of model.toml: numbers of the effects' states that were scaled to the boat's size.

    Keys are names of states. Each entry has the initial standard deviation ``sd0`` and the process noise ``noise``,
    except those that are parameters. States of user-defined effects are not scaled and are left out.
    ``effects_file`` is the Python file with these effects; None if there is none.
    """
    own = load_effects(effects_file) if effects_file is not None else {}
    return {
        s.name: {k: float(z) for k in STATE_NUMBERS if not isinstance(z := getattr(s, k), str)}
        for e in model.effects
        if _is_scaled_to_boat(e, own)
        for s in e.states
    }


def _is_scaled_to_boat(effect: Effect, own: Mapping[str, Effect]) -> bool:
    """Return whether the priors and states of an effect are scaled to the size of the boat.

    Effects of the catalogue and nonparametric effects are scaled; user-defined effects (``own``, by name) are not, even
    if they have the name of an effect of the catalogue.
    """
    return (effect.name in catalogue() and effect.name not in own) or effect.kind.nonparametric


def _scale_table(model: Model, calibration: float | None, rpm_max: float | None) -> Any:
    """Return the table ``scale`` of model.toml: provenance of the thrust and the thrusters' arms; warnings as comments.

    For a bench model the thrust is measured. The relative uncertainty ``calibration`` of the load cell, and the shaft
    speed ``rpm_max`` at n = 1 [rev/min], are written if they are known. None if the table would be empty.
    """
    scale, table = thrust_scale_of(model), tomlkit.table()
    for line in scale.caveats:
        table.add(tomlkit.comment(line))
    facts = {"thrust": scale.thrust, "arm": scale.arm}
    table.update({name: str(origin) for name, origin in facts.items() if origin is not None})
    if model.kind is ModelKind.BENCH and "c1" in model.values:
        known = {"calibration": calibration, "rpm_max": None if rpm_max is None else float(f"{rpm_max:.9g}")}
        table.update({"thrust": "measured"} | {name: value for name, value in known.items() if value is not None})
    return table if len(table) else None


def _curve_table(effect: Effect) -> dict[str, Any]:
    """Return the table of model.toml under ``curves`` that defines a nonparametric effect.

    Such an effect is a force as a free curve over a signal, or a lagged or resonant response to an input. It has no
    entry in the catalogue, from which it could be read again. AssertionError is raised for other effects.
    """
    assert effect.curve is not None
    curve = effect.curve
    table = {"kind": str(effect.kind), "force": curve.force, "variable": curve.variable}
    table |= {"second": curve.second} if curve.second else {}
    return table | ({"span": list(effect.span)} if effect.span is not None else {})


def _copy_beside_model(path: Path, file: Path) -> Path:
    """Copy a Python file into the folder of the model.toml at ``path``, unless it is there. Return the copy's path.

    If another file there has the same name, the copy has the digest of the file in its name. The copy counts as
    trusted: `load_model` may run it without a question.
    """
    text, place = file.read_bytes(), path.parent / file.name
    if place.exists() and place.read_bytes() != text:
        place = path.parent / f"{file.stem}_{file_digest(file)}.py"
    if not place.exists():
        write_output(place, text, force=False)
    remember_trusted_file(place)
    return place


def _parameter_table(p: Parameter, fit: Fit, *, with_prior: bool) -> dict[str, Any]:
    """Return the table of a parameter in model.toml: value, unit, standard error, prior and so on, where they apply.

    A per-record parameter is written with its value in the model, the mean over the records, and with the standard
    error of this mean. ``with_prior`` is whether to write the prior of the parameter.
    """
    value, error = fit.estimate(p.name)
    if p.per_record:
        each = [k for k, q in enumerate(fit.parameters) if q.name == p.name]
        error = np.sqrt(fit.covariance[np.ix_(each, each)].sum()) / len(each) if each else np.nan
    row: dict[str, Any] = {
        "name": p.name,
        "value": float(value if not p.per_record else p.value),
        "unit": p.unit,
        "meaning": p.meaning,
        "free": p.free,
        "origin": str(p.provenance),
    }
    if np.isfinite(error):
        row["se"] = float(error)
    at = fit.names.index(p.name) if p.name in fit.names else None
    if at is not None and fit.inflation[at] > NOTABLE_INFLATION:
        row["se_inflation"] = float(np.round(fit.inflation[at], 4))
    if p.prior is not None and with_prior:
        row["prior"] = [float(z) for z in p.prior]
    if p.considered:
        row["considered"] = True
    if p.per_record:
        row["per_record"] = True
    flag, share = dict(fit.flags).get(p.name), 0.0 if at is None else float(fit.prior_weight[at])
    of_prior = given_prior_flags(p, (value, float(error)), share)
    told = bool(of_prior) or agrees_with_bench(p, value)
    own = () if flag is None or (told and flag.code == "prior") else (flag,)
    return row | {"flag": "; ".join((*own, *of_prior))} if own or of_prior else row


def model_file(path: Path) -> Path:
    """Return the model.toml that a path stands for: the one in a folder, or the one beside a result.json.

    Any other path, also of a folder or result.json without a model.toml, is returned unchanged; `load_model` reports
    it. If a result.json stands for its model, a warning names the model.
    """
    if path.name == RESULT and path.is_file() and (beside := path.with_name(MODEL)).is_file():
        warn(f"{path}: this is a result file; its model {beside} is used")
        return beside
    inside = path / MODEL
    return inside if inside.is_file() else path


def model_source(text: str, names: Collection[str] = ("auto", *BUILT_IN)) -> str:
    """Return the source of a model: a folder or a result.json of a fit becomes the path of its model.toml.

    Parameters
    ----------
    text
        Name of a model, FILE.py:NAME, or path.
    names
        Names that stand for themselves, even if there is a folder of the same name. ``./NAME`` is the folder.

    Returns
    -------
    str
        The path of the model.toml, or ``text``.

    Raises
    ------
    SeatrialError
        If the path is a folder without a model.toml.
    """
    path = Path(text)
    if text in names or not path.exists():
        return text
    if (found := model_file(path)).is_dir():
        raise SeatrialError(f"{found}: this folder has no {MODEL}; give the folder of a fit, or its {MODEL}")
    return str(found)


def leaves_validity(least: float, most: float, fitted: tuple[float, float]) -> bool:
    """Return whether a signal from ``least`` to ``most`` is outside its range in the fitted data by more than a tenth.

    The tenth (`VALIDITY_MARGIN`) is that of the width of the range ``fitted``. A range without ends is never left.
    """
    low, high = fitted
    room = VALIDITY_MARGIN * (high - low)
    return least < low - room or most > high + room


def effects_per_run(model: Model) -> dict[str, tuple[str, ...]]:
    """Return the estimated per-record parameters of each added effect, by the name of the effect.

    Disturbances and offsets of sensors are left out: as the current, they differ between the runs of any model. Effects
    without such parameters are left out too.
    """
    own = {p.name for p in model.parameters if p.free and p.per_record}
    added = [e for e in model.effects if not e.kind.nuisance]
    found = {e.name: tuple(p.name for p in e.parameters if p.name in own) for e in added}
    return {name: parameters for name, parameters in found.items() if parameters}


def warn_of_run_means(model: Model) -> None:
    """Warn that parameters of effects have their means over the runs, in a model that is used for other runs.

    There is no warning if no effect has a parameter with a value of its own in each run (`effects_per_run`).
    """
    for effect, names in effects_per_run(model).items():
        listed = ", ".join(f"{n} = {model.values[n]:.3g}: {model.parameter(n).meaning}" for n in names)
        warn(
            f"{effect}: its parameters differ between the fitted runs, and the model has their means ({listed}), which "
            "may be true for no run; the report and result.json have the value of each run"
        )


def unconverged_sentence(subject: str) -> str:
    """Return the warning about the use of a model whose fit did not converge, as one sentence without a full stop.

    ``subject`` names the fit, for example ``the fit of this model``.
    """
    return (
        f"{subject} did not converge, so its estimates, errors and motion may be far from those of the boat: fit it "
        "again with other initial values or priors, or with fewer free parameters"
    )


def warn_if_unconverged(converged: bool) -> None:
    """Warn that a model is used whose fit did not converge, if ``converged`` is False."""
    if not converged:
        warn(unconverged_sentence("the fit of this model"))


def load_model(path: Path) -> SavedModel:
    """Read a fitted model from a model.toml.

    A Python file that it names is run only if this user has run the same file before, or has allowed it with
    ``--trust-code`` (`seatrial.ident.models.trusted_file`).

    Raises
    ------
    SeatrialError
        If the path is a folder or a log, or if the file cannot be read or is not a complete model. The message contains
        the path and the reason.
    """
    if path.is_dir():
        raise SeatrialError(f"{path}: this folder has no {MODEL}; give the folder of a fit, or its {MODEL}")
    if is_log(path):
        raise SeatrialError(f"{path}: is a log; give a {MODEL} or the folder of a fit")
    text = read_text(path)
    if text.lstrip().startswith("{"):
        raise SeatrialError(
            f"{path}: this is a result file (JSON), not a model, and no {MODEL} is beside it; give the {MODEL} of a fit"
        )
    if text.lstrip().startswith("<"):
        raise SeatrialError(f"{path}: this is a page (HTML), not a model; give the {MODEL} beside it, or the folder")
    table = parse_toml(text, path).values
    if table.get("format") != FORMAT:
        raise SeatrialError(f"{path}: format is {table.get('format')!r}, not {FORMAT!r}: give a model.toml of seatrial")
    try:
        source, effects_file = _trusted_python_files(table, path)
        model = _build_model(table, source, load_effects(effects_file) if effects_file is not None else {})
        errors = {row["name"]: float(row.get("se", np.nan)) for row in table["parameter"]}
        inflation = {row["name"]: float(row["se_inflation"]) for row in table["parameter"] if "se_inflation" in row}
        place = table.get("origin")
        origin = place and FrameOrigin(float(place["latitude"]), float(place["longitude"]), str(place.get("log", "")))
        validity = {k: (float(a), float(b)) for k, (a, b) in table.get("validity", {}).items()}
        rates = {k: float(z) for k, z in table.get("rates", {}).items()}
        holds = {k: str(z) for k, z in table.get("holds", {}).items()}
        if bad := [k for k, z in rates.items() if not 0.0 < z < np.inf]:
            raise ValueError(f"rates: {bad[0]} = {rates[bad[0]]:g}; a rate must be finite and above 0 Hz")
        estimates = table.get("correlation", {})
        names = tuple(str(n) for n in estimates.get("names", ()))
        correlation = np.asarray(estimates.get("matrix", ()), dtype=float).reshape(len(names), len(names))
        reml = bool(table.get("reml", False))
        provenance, scale = dict(table.get("provenance", {})), table.get("scale", {})
        calibration, rpm_max = (
            None if (z := scale.get(key)) is None else float(z) for key in ("calibration", "rpm_max")
        )
        if rpm_max is not None and not 0.0 < rpm_max < np.inf:
            raise ValueError(f"scale: rpm_max = {rpm_max:g}; it must be finite and above 0 rev/min")
        refits = _refits_from_tables(table.get("refit", ()))
        intervals = _intervals_from_table(table.get("intervals"))
        converged = bool(table.get("converged", True))
        flags = {row["name"]: str(row["flag"]) for row in table["parameter"] if "flag" in row}
    except (AttributeError, KeyError, TypeError, ValueError) as problem:  # AttributeError: a value instead of a table
        raise SeatrialError(
            f"{path}: the model in this file is incomplete or does not match this version of seatrial, so fit it "
            f"again: {_reason(problem)}"
        ) from problem
    return SavedModel(
        model,
        errors,
        validity,
        provenance,
        names,
        correlation,
        effects_file,
        reml,
        calibration,
        origin,
        inflation,
        rates,
        holds,
        refits,
        intervals,
        converged,
        flags,
        rpm_max,
    )


def _reason(problem: Exception) -> str:
    """Return the reason why a model.toml cannot be read, for the message, from the error that was raised.

    A KeyError whose text is a single word names a missing entry; any other one has a text of its own. A TypeError or
    AttributeError comes from a value of the wrong type. The text of any other error is returned as it is.
    """
    if isinstance(problem, KeyError):
        text = str(problem.args[0])
        return text if " " in text else f"it has no entry {text!r}"
    if isinstance(problem, (AttributeError, TypeError)):
        return f"one of its entries has a wrong type ({problem})"
    return str(problem)


def _trusted_python_files(table: Mapping[str, Any], path: Path) -> tuple[str, Path | None]:
    """Return the source of the model's structure, and the file of user-defined effects (None if there is none).

    The source is the name of a catalogue model or ``FILE:FUNCTION``. Python files are searched in the folder of
    ``path``, and SeatrialError is raised if one is missing or not trusted.
    """
    source, effects = str(table["source"]), None
    file, _, name = source.rpartition(":")
    if is_own_model(source):
        source = f"{trusted_file(path, file, table.get('source_sha256'))}:{name}"
    if "effects_file" in table:
        effects = trusted_file(path, str(table["effects_file"]), table.get("effects_sha256"))
    return source, effects


def _build_model(table: Mapping[str, Any], source: str, own: Mapping[str, Effect]) -> Model:
    """Return the model that a model.toml describes: its structure with effects, outlier model and parameter values.

    A parameter without a table in the file is that of the structure. Effects are added in the order of the file; one
    that the structure has already is not added again. A user-defined effect takes precedence over an effect of the
    catalogue with the same name.

    Parameters
    ----------
    table
        Content of the whole file.
    source
        Name of a catalogue model, or ``FILE:FUNCTION`` of a user-defined one.
    own
        User-defined effects by name.

    Raises
    ------
    KeyError, ValueError
        If an entry is missing or inconsistent. `load_model` adds the path to the message.
    """
    model = own_model(source) if is_own_model(source) else catalogue_model(source, table["sensors"])
    size, written = _vessel_size(model, table["parameter"]), {row["name"] for row in table["parameter"]}
    for name in table["effects"]:
        if name not in {e.name for e in model.effects}:
            effect = own[name] if name in own else _effect_by_name(name, model, table.get("curves", {}))
            if name == ESTIMATOR_ERROR and not {p.name for p in effect.parameters} <= written:
                raise ValueError("its navigation errors are stored in an older format")
            if _is_scaled_to_boat(effect, own):
                _check_units(effect, table["parameter"])
                effect = _with_bounds_around_values(scale_priors(effect, size), table["parameter"])
                saved = table.get("states", {})
                effect = replace(
                    effect, states=tuple(_with_saved_state_numbers(s, saved.get(s.name, {})) for s in effect.states)
                )
            model = model + effect
    model = replace(
        with_outlier_model(model, table.get("robust", [])), second_order=bool(table.get("second_order", False))
    )
    rows = {row["name"]: row for row in table["parameter"]}
    unknown = set(rows) - set(model.values)
    if unknown:
        raise ValueError(f"model {model.name} has no parameter {sorted(unknown)[0]!r}")
    return model.replace_parameters(
        *(_parameter_from_table(p, rows[p.name]) for p in model.parameters if p.name in rows)
    )


def _with_saved_state_numbers(state: State, row: Mapping[str, Any]) -> State:
    """Return the state with the initial standard deviation ``sd0`` and the process noise ``noise`` of its file table.

    Numbers that the table ``row`` lacks are not changed. Other entries of the table are ignored.
    """
    numbers: dict[str, Any] = {k: float(row[k]) for k in STATE_NUMBERS if k in row}
    return replace(state, **numbers)


def _vessel_size(model: Model, rows: Sequence[Mapping[str, Any]]) -> VesselScale:
    """Return the size of the boat that a model.toml describes, from its surge mass and yaw inertia.

    Steps and bounds of effects are not in the file; they scale with this size. ``rows`` are the tables of the
    parameters in the file.
    """
    masses = {row["name"]: float(row["value"]) for row in rows if row["name"] in ("m_u", "m_r")}
    return size_of(model.with_values({n: z for n, z in masses.items() if n in model.values}))


def _check_units(effect: Effect, rows: Sequence[Mapping[str, Any]]) -> None:
    """Raise ValueError if a coefficient of a lagged or resonant response has another unit in the file than it has now.

    Coefficients of other effects are not checked. ``rows`` are the tables of the parameters in the file.
    """
    units = {p.name: p.unit for p in effect.parameters} if effect.kind is not EffectKind.NONPARAMETRIC else {}
    for row in rows:
        if effect.kind.nonparametric and row.get("unit", "") != units.get(row["name"], row.get("unit", "")):
            now = units[row["name"]] or "1"
            raise ValueError(
                f"parameter {row['name']} is stored in {row['unit'] or '1'}, but this version has it in {now}"
            )


def _with_bounds_around_values(effect: Effect, rows: Sequence[Mapping[str, Any]]) -> Effect:
    """Widen the bounds of an effect's scaled parameters so that they include the values in the file. Return the effect.

    Bounds are scaled with the size of the boat. The fit that wrote the file may have assumed another size, so that a
    value at its bound may lie outside the bounds of today. A bound of zero does not depend on the size and stays, and
    so do the bounds of parameters that are not scaled. ``rows`` are the tables of the parameters in the file.
    """
    values = {row["name"]: float(row["value"]) for row in rows}

    def wide(p: Parameter) -> Parameter:
        """Return the parameter with bounds that include its value in the file; a bound of zero stays."""
        value, (low, high) = values.get(p.name, p.value), p.bounds
        # a bound of zero does not depend on the size: it stays
        return replace(p, bounds=(low and min(low, value), high and max(high, value)))

    return replace(effect, parameters=tuple(wide(p) if p.scales else p for p in effect.parameters))


def _parameter_from_table(p: Parameter, row: Mapping[str, Any]) -> Parameter:
    """Return the parameter p of the model's structure with the entries of its table ``row`` in the file.

    The entries are the value, whether it is free, considered or per record, the prior and the origin. Without a prior
    in the table, the parameter keeps its prior. If the origin in the table is ``estimated``, the parameter keeps the
    origin that it has in the structure. ValueError is raised for a prior that is not valid.
    """
    origin = ParameterOrigin(row.get("origin", "given"))
    estimated = origin is ParameterOrigin.ESTIMATED
    prior = p.prior
    if "prior" in row:
        mean, sd = (float(z) for z in row["prior"])
        if not (sd > 0 and (mean > 0 or p.transform != "log")):
            needed = (
                "a positive mean and standard deviation" if p.transform == "log" else "a positive standard deviation"
            )
            raise ValueError(f"parameter {p.name}: its prior [{mean:g}, {sd:g}] needs {needed}")
        prior = mean, sd
    return replace(
        p,
        value=float(row["value"]),
        free=bool(row["free"]),
        considered=bool(row.get("considered", False)),
        per_record=bool(row.get("per_record", p.per_record)),
        prior=prior,
        origin=p.origin if estimated else origin,
    )


def _effect_by_name(name: str, model: Model, curves: Mapping[str, Any]) -> Effect:
    """Return an effect by its name in a model.toml.

    The effect is a component of the model (such as disturbance forces), a nonparametric effect, a between-run effect,
    or an effect of the catalogue.

    Parameters
    ----------
    name
        Name of the effect.
    model
        Model to which the effect will be added.
    curves
        Table ``curves`` of the file, by name of the nonparametric effect.

    Raises
    ------
    ValueError
        If there is no effect of this name, or if the model cannot have the disturbance or nonparametric effect.
    KeyError
        If the model lacks the parameter of a between-run effect, or if the table of a nonparametric effect lacks an
        entry.
    """
    if name == "disturbance":
        return disturbance_of(model)
    if name == "sensor-bias":
        return sensor_bias([s.name for s in model.sensors])
    if name == ANTENNA:
        return antenna_component(model)
    if name == CURRENT_WALK:
        return current_walk()
    if name == TELEMETRY_AGE:
        return telemetry_age()
    if name == THRUST_CALIBRATION:
        return thrust_calibration(model)
    if name == ESTIMATOR_ERROR:
        return estimator_error([s.name for s in model.sensors])
    if name in curves:
        return _effect_from_curve_table(model, curves[name])
    if name.startswith(BETWEEN):
        return between_runs_effect(model, name.removeprefix(BETWEEN))
    if name not in catalogue():
        raise ValueError(f"there is no effect {name!r} in the catalogue")
    return catalogue()[name]


def _effect_from_curve_table(model: Model, row: Mapping[str, Any]) -> Effect:
    """Return the nonparametric effect of ``model`` that the table ``row`` under ``curves`` of a model.toml defines.

    ValueError is raised if the model cannot have this effect.
    """
    kind = EffectKind(row["kind"])
    curve = ForceCurve(row["force"], row["variable"], row.get("second", ""))
    if kind is EffectKind.NONPARAMETRIC:
        low, high = row.get("span", (-np.pi, np.pi))
        return nonparametric_effect(model, curve, (float(low), float(high)))
    for effect in input_response_effects(model):
        if (effect.kind, effect.curve) == (kind, curve):
            return effect
    raise ValueError(f"model {model.name} has no {kind} effect of {curve.force} on {curve.variables}")
