"""Reading and writing of model.toml, a fitted model. See docs/formats/model.md."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from seatrial.daq.config import parse_toml, read_text
from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.ident.data import FrameOrigin
from seatrial.ident.effects import catalogue, input_response_effects, nonparametric_effect
from seatrial.ident.estimation.homogeneity import BETWEEN, between_runs_effect
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.estimation.parameter_covariance import ParameterCovariance
from seatrial.ident.estimation.thrust_scale import scale_of
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
    remember,
    scale_priors,
    sensor_bias,
    size_of,
    telemetry_age,
    thrust_calibration,
    trusted_file,
)
from seatrial.ident.numerics import Array

FORMAT = "seatrial-model 1"
NOTABLE_INFLATION = 1.001  # of a standard error: below it is rounding
STATE_NUMBERS = ("sd0", "noise")  # of a state, where no parameter holds them


@dataclass(frozen=True)
class SavedModel:
    """A model read back. ``errors``: standard errors by name (NaN: none); ``validity``: ranges by signal;
    ``correlation`` (n, n): of the estimates ``names``; ``reml``: noise by restricted likelihood."""

    model: Model
    errors: Mapping[str, float]
    validity: Mapping[str, tuple[float, float]]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    correlation: Array = field(default_factory=lambda: np.zeros((0, 0)))
    effects_file: Path | None = None  # where effects that are not in the catalogue come from
    reml: bool = False
    calibration: float | None = None  # relative standard uncertainty of the forces that it was fitted to; None: unknown
    origin: FrameOrigin | None = None  # from which its fixed points count; None: it has none, or nobody knows
    # by parameter, factor by which correlated residuals made its standard error larger than by the information
    inflation: Mapping[str, float] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)  # by sensor: its samples a second in the fitted data [Hz]

    def uncertainty(self, name: str) -> float:
        """Standard uncertainty of an estimated force: of its estimate and of the load cell's calibration; NaN where the
        estimate has none."""
        return float(np.hypot(self.errors[name], (self.calibration or 0.0) * self.model.parameter(name).value))

    def covariance(self, wanted: Collection[str] | None = None) -> ParameterCovariance:
        """Covariance of the estimates, or of those in ``wanted``, that have a standard error."""
        names = self.names if wanted is None else [n for n in self.names if n in wanted]
        known = tuple(n for n in names if np.isfinite(self.errors.get(n, np.nan)) and self.errors[n] > 0.0)
        at = [self.names.index(n) for n in known]
        se = np.array([self.errors[n] for n in known])
        return ParameterCovariance(known, self.correlation[np.ix_(at, at)] * np.outer(se, se))


def save_model(
    path: Path,
    fit: Fit,
    *,
    validity: Mapping[str, tuple[float, float]],
    provenance: Mapping[str, Any],
    effects_file: Path | None = None,
    calibration: float | None = None,
    origin: FrameOrigin | None = None,
    rates: Mapping[str, float] | None = None,
) -> None:
    """Write the model of a fit, and beside it a copy of each Python file of the user's own that it is made with.
    ``effects_file``: where effects that are not in the catalogue come from; ``calibration``: relative standard
    uncertainty of the forces that were measured; ``origin``: of x and y of the logs, which a model with a fixed point
    keeps; ``rates``: by sensor, its samples a second in the fitted data, of averages where it was averaged [Hz]."""
    model, document = fit.model, tomlkit.document()
    document["format"] = FORMAT
    document["name"] = model.name
    file, _, own = model.source.rpartition(":")
    if is_own_model(model.source) and Path(file).is_file():
        beside = _copied(path, Path(file))
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
    unlisted = {e.name: _curve_table(e) for e in model.effects if e.kind.unknown}
    if unlisted:
        document["curves"] = unlisted
    if effects_file is not None:
        beside = _copied(path, effects_file)
        document["effects_file"], document["effects_sha256"] = beside.name, file_digest(beside)
    document["provenance"] = {k: v for k, v in provenance.items() if v is not None}
    if (scale := _scale_table(model, calibration)) is not None:
        document["scale"] = scale
    if origin is not None and any(e.fixed_point for e in model.effects):
        document["origin"] = asdict(origin)
    document["validity"] = {k: [float(a), float(b)] for k, (a, b) in validity.items()}
    if rates:
        document["rates"] = {k: float(f"{z:.4g}") for k, z in rates.items()}
    if states := _states_table(model, effects_file):
        document["states"] = states
    # disturbance forces get the size of the boat whenever a fit begins (seatrial.ident.models.scaling); a prior of that
    # size would get it twice
    sized_anew = {p.name for e in model.effects if e.kind is EffectKind.DISTURBANCE for p in e.parameters}
    parameters = tomlkit.aot()
    for p in model.parameters:
        table = tomlkit.table()
        table.update(_row(p, fit, with_prior=p.name not in sized_anew))
        parameters.append(table)
    document["parameter"] = parameters
    document["correlation"] = {"names": list(fit.names), "matrix": np.round(np.nan_to_num(fit.correlation), 6).tolist()}
    write_output(path, tomlkit.dumps(document))


def _states_table(model: Model, effects_file: Path | None) -> dict[str, dict[str, float]]:
    """Numbers of the states of effects, which go with the size of the boat that the fit began with."""
    own = load_effects(effects_file) if effects_file is not None else {}
    return {
        s.name: {k: float(z) for k in STATE_NUMBERS if not isinstance(z := getattr(s, k), str)}
        for e in model.effects
        if _is_sized(e, own)
        for s in e.states
    }


def _is_sized(effect: Effect, own: Mapping[str, Effect]) -> bool:
    """Whether it goes with the size of the boat (``scale_priors``); the user's own are as they were written."""
    return (effect.name in catalogue() and effect.name not in own) or effect.kind.unknown


def _scale_table(model: Model, calibration: float | None) -> Any:
    """Return the table of where thrust and arm come from; None if the model has no forces of its own."""
    scale, table = scale_of(model), tomlkit.table()
    for line in scale.caveats:
        table.add(tomlkit.comment(line))
    facts = {"thrust": scale.thrust, "arm": scale.arm}
    table.update({name: str(origin) for name, origin in facts.items() if origin is not None})
    if model.kind is ModelKind.BENCH and "c1" in model.values:
        table.update({"thrust": "measured"} | ({} if calibration is None else {"calibration": calibration}))
    return table if len(table) else None


def _curve_table(effect: Effect) -> dict[str, Any]:
    """What tells an effect that no catalogue lists."""
    assert effect.curve is not None
    curve = effect.curve
    table = {"kind": str(effect.kind), "force": curve.force, "variable": curve.variable}
    table |= {"second": curve.second} if curve.second else {}
    return table | ({"span": list(effect.span)} if effect.span is not None else {})


def _copied(path: Path, file: Path) -> Path:
    """The file in the model's folder: itself or a copy, under a name of its own where another file has its name."""
    text, place = file.read_bytes(), path.parent / file.name
    if place.exists() and place.read_bytes() != text:
        place = path.parent / f"{file.stem}_{file_digest(file)}.py"
    if not place.exists():
        write_output(place, text, force=False)
    remember(place)
    return place


def _row(p: Parameter, fit: Fit, *, with_prior: bool) -> dict[str, Any]:
    """A parameter's table: what does not apply is left out."""
    value, error = fit.estimate(p.name)
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
    flag = dict(fit.flags).get(p.name)
    return row if flag is None else row | {"flag": flag}


def load_model(path: Path) -> SavedModel:
    """Read a model.toml. A Python file that it names is run only where `seatrial.ident.models.trusted_file` allows it.

    Raises SeatrialError with what is wrong and where.
    """
    if path.is_dir():
        raise SeatrialError(f"{path}: is a folder; give the model in it: {path / 'model.toml'}")
    text = read_text(path)
    if text.lstrip().startswith("{"):
        raise SeatrialError(f"{path}: is JSON, as a result is; give the model.toml beside it")
    table = parse_toml(text, path).values
    if table.get("format") != FORMAT:
        raise SeatrialError(f"{path}: format is {table.get('format')!r}, not {FORMAT!r}: give a model.toml of seatrial")
    try:
        source, effects_file = _own_files(table, path)
        model = _build(table, source, load_effects(effects_file) if effects_file is not None else {})
        errors = {row["name"]: float(row.get("se", np.nan)) for row in table["parameter"]}
        inflation = {row["name"]: float(row["se_inflation"]) for row in table["parameter"] if "se_inflation" in row}
        place = table.get("origin")
        origin = place and FrameOrigin(float(place["latitude"]), float(place["longitude"]), str(place.get("log", "")))
        validity = {k: (float(a), float(b)) for k, (a, b) in table.get("validity", {}).items()}
        rates = {k: float(z) for k, z in table.get("rates", {}).items()}
        if bad := [k for k, z in rates.items() if not 0.0 < z < np.inf]:
            raise ValueError(f"rates: {bad[0]} = {rates[bad[0]]:g}; a rate is above 0 Hz")
        between = table.get("correlation", {})
        names = tuple(str(n) for n in between.get("names", ()))
        correlation = np.asarray(between.get("matrix", ()), dtype=float).reshape(len(names), len(names))
        reml = bool(table.get("reml", False))
        made, calibration = dict(table.get("provenance", {})), table.get("scale", {}).get("calibration")
        calibration = None if calibration is None else float(calibration)
    except (AttributeError, KeyError, TypeError, ValueError) as problem:  # attribute: a value where a table should be
        raise SeatrialError(f"{path}: not a complete model: {problem}") from problem
    return SavedModel(
        model, errors, validity, made, names, correlation, effects_file, reml, calibration, origin, inflation, rates
    )


def _own_files(table: Mapping[str, Any], path: Path) -> tuple[str, Path | None]:
    """The source of the structure and the file of effects, as they are found from here."""
    source, effects = str(table["source"]), None
    file, _, name = source.rpartition(":")
    if is_own_model(source):
        source = f"{trusted_file(path, file, table.get('source_sha256'))}:{name}"
    if "effects_file" in table:
        effects = trusted_file(path, str(table["effects_file"]), table.get("effects_sha256"))
    return source, effects


def _build(table: Mapping[str, Any], source: str, own: Mapping[str, Effect]) -> Model:
    model = own_model(source) if is_own_model(source) else catalogue_model(source, table["sensors"])
    size, written = _size(model, table["parameter"]), {row["name"] for row in table["parameter"]}
    for name in table["effects"]:
        if name not in {e.name for e in model.effects}:
            effect = own[name] if name in own else _effect(name, model, table.get("curves", {}))
            if name == ESTIMATOR_ERROR and not {p.name for p in effect.parameters} <= written:
                raise ValueError("its errors of an estimator are of an older form: fit the model again")
            if _is_sized(effect, own):
                _check_units(effect, table["parameter"])
                effect = _holding(scale_priors(effect, size), table["parameter"])
                begun = table.get("states", {})
                effect = replace(effect, states=tuple(_begun(s, begun.get(s.name, {})) for s in effect.states))
            model = model + effect
    model = replace(
        with_outlier_model(model, table.get("robust", [])), second_order=bool(table.get("second_order", False))
    )
    rows = {row["name"]: row for row in table["parameter"]}
    unknown = set(rows) - set(model.values)
    if unknown:
        raise ValueError(f"model {model.name} has no parameter {sorted(unknown)[0]!r}")
    return model.replace_parameters(*(_parameter(p, rows[p.name]) for p in model.parameters if p.name in rows))


def _begun(state: State, row: Mapping[str, Any]) -> State:
    numbers: dict[str, Any] = {k: float(row[k]) for k in STATE_NUMBERS if k in row}
    return replace(state, **numbers)


def _size(model: Model, rows: Sequence[Mapping[str, Any]]) -> VesselScale:
    """Of the boat that the file is of: steps and bounds of its effects are not in it."""
    masses = {row["name"]: float(row["value"]) for row in rows if row["name"] in ("m_u", "m_r")}
    return size_of(model.with_values({n: z for n, z in masses.items() if n in model.values}))


def _check_units(effect: Effect, rows: Sequence[Mapping[str, Any]]) -> None:
    """Raises ValueError where the file has lagged or resonant coefficients in another unit than they have now."""
    units = {p.name: p.unit for p in effect.parameters} if effect.kind is not EffectKind.NONPARAMETRIC else {}
    for row in rows:
        if effect.kind.unknown and row.get("unit", "") != units.get(row["name"], row.get("unit", "")):
            now = units[row["name"]] or "1"
            raise ValueError(f"parameter {row['name']} is in {row['unit'] or '1'}, now in {now}: fit the model again")


def _holding(effect: Effect, rows: Sequence[Mapping[str, Any]]) -> Effect:
    """The effect with bounds that hold the file's values: they go with the size of the boat, which the fit that found a
    value at its bound may have taken for another."""
    values = {row["name"]: float(row["value"]) for row in rows}

    def wide(p: Parameter) -> Parameter:
        value, (low, high) = values.get(p.name, p.value), p.bounds
        return replace(p, bounds=(low and min(low, value), high and max(high, value)))  # zero is so for all sizes

    return replace(effect, parameters=tuple(wide(p) if p.scales else p for p in effect.parameters))


def _parameter(p: Parameter, row: Mapping[str, Any]) -> Parameter:
    """Return a parameter of the structure with the values of its row. A row without a prior keeps the structure's."""
    origin = ParameterOrigin(row.get("origin", "given"))
    estimated = origin is ParameterOrigin.ESTIMATED
    prior = p.prior
    if "prior" in row:
        mean, sd = (float(z) for z in row["prior"])
        if not (sd > 0 and (mean > 0 or p.transform != "log")):
            what = "a positive mean and standard deviation" if p.transform == "log" else "a positive standard deviation"
            raise ValueError(f"parameter {p.name}: its prior [{mean:g}, {sd:g}] needs {what}")
        prior = mean, sd
    return replace(
        p,
        value=float(row["value"]),
        free=bool(row["free"]),
        considered=bool(row.get("considered", False)),
        prior=prior,
        origin=p.origin if estimated else origin,
    )


def _effect(name: str, model: Model, curves: Mapping[str, Any]) -> Effect:
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
        return _unlisted(model, curves[name])
    if name.startswith(BETWEEN):
        return between_runs_effect(model, name.removeprefix(BETWEEN))
    if name not in catalogue():
        raise ValueError(f"there is no effect {name!r} in the catalogue")
    return catalogue()[name]


def _unlisted(model: Model, row: Mapping[str, Any]) -> Effect:
    """The effect that a table under ``curves`` tells."""
    kind = EffectKind(row["kind"])
    curve = ForceCurve(row["force"], row["variable"], row.get("second", ""))
    if kind is EffectKind.NONPARAMETRIC:
        low, high = row.get("span", (-np.pi, np.pi))
        return nonparametric_effect(model, curve, (float(low), float(high)))
    for effect in input_response_effects(model):
        if (effect.kind, effect.curve) == (kind, curve):
            return effect
    raise ValueError(f"model {model.name} has no {kind} effect of {curve.force} on {curve.variables}")
