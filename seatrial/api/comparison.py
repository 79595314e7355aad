"""Comparison of fitted models on the same logs, for the Python interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, overload

import numpy as np

from seatrial.api import tables
from seatrial.api.arguments import as_path, check_above_zero, check_rate, named_arguments, output_folder
from seatrial.api.calls import python_call
from seatrial.api.figures import Figure
from seatrial.api.fits import FittedResult, Logs, model_path, refuse_log, window_of
from seatrial.api.logs import Log, PathLike, as_logs
from seatrial.api.messages import Messages, errors_of_users, text_of, warn_of_result
from seatrial.api.series import ByRecord, ComparedPredictions, Prediction, Series
from seatrial.api.shown import Content, Shown, number
from seatrial.daq.errors import NamedValues, SeatrialError
from seatrial.daq.log import import_library
from seatrial.ident.numerics import wrap

if TYPE_CHECKING:
    from seatrial.ident.results import ComparedModel, ComparisonResult

AnyModel = Any  # PathLike, FittedVehicle, FittedDiagnosis or Saved, which is imported only if it is needed
RATIO = ("ratio", "low", "high", "blocks", "verdict")  # columns of the ratio of an error to that of the first model
Models = Sequence[AnyModel] | Mapping[str, AnyModel]


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Comparison of fitted models by their predictions of the same logs. `compare` returns it.

    One model alone is evaluated on logs that it has not seen.

    Attributes
    ----------
    result : ComparisonResult
        Content of result.json: for each model and channel the errors one step ahead, over each horizon and in
        simulation, and the shares of them inside its 95 % intervals; with verdicts on the differences between models by
        95 % intervals; log score and information criteria; and the predictions over time.
    """

    result: ComparisonResult

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each model; the first one is the reference."""
        return tuple(m.name for m in self.result.models)

    @property
    def answer(self) -> str:
        """Best model over the first horizon, the models that are as good, and its error over all channels.

        The error is compared with that of the first model, or with that of the nearest model that is worse. Of models
        without a clear difference, the one with the fewest estimated parameters is named.

        For one model alone, it is the median fit of its channels, and the share of the errors inside its 95 %
        intervals.
        """
        return tables.conclusion(self.result)

    @property
    def best(self) -> str:
        """Name of the model with the smallest prediction error over the first horizon.

        Only models are considered that are significantly better than another one, and than which no other one is
        significantly better: the 95 % interval of the change of the prediction error excludes no change. If there are
        none, all models are. The order of the models does not matter.
        """
        return next(m.name for m in self.result.models if m.label == self.result.best)

    @property
    def notes(self) -> list[str]:
        """Notes of the result, one text for each: assumptions, and the times that have most of the errors."""
        return tables.note_texts(self.result)

    @property
    def masses(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Masses ``m_u``, ``m_v`` and yaw inertia ``m_r`` of each model by its name, as (value, standard error).

        They are in SI units; ratios to an unknown thrust have names such as ``m_u/T``. The standard error is NaN if the
        mass is fixed. A model without masses has an empty dict. `result.weighed_mass` is the weighed mass [kg] by the
        rig or import map of the first log, or None.
        """
        return {
            m.name: {x.name: (x.value, np.nan if x.se is None else x.se) for x in m.masses} for m in self.result.models
        }

    def summary(self) -> str:
        """Return the comparison as text, as the command prints it: answer, errors by channel, and likelihoods."""
        return text_of(self.result)

    def to_pandas(self) -> Any:
        """Return all errors as a ``pandas.DataFrame``: a row for each kind of prediction, channel and model.

        The columns are ``kind`` (one_step, horizon, simulation), ``seconds`` (the horizon, else NaN), ``channel``,
        ``unit``, ``model`` (its name), ``rms`` (NaN: diverged), ``fit`` (1: perfect), ``inside_95`` (share of the
        errors inside the 95 % intervals), ``intervals`` (verdict on these), ``ratio``, ``low``, ``high``, ``blocks``
        and ``verdict`` (against the first model, with the 95 % interval and the number of independent blocks
        of time; ``no-interval`` with fewer than four), and ``best`` (whether the error is the smallest).
        A model has no row for a channel that it does not predict.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        names = {m.label: m.name for m in self.result.models}
        rows = []
        for row in self.result.channels:
            of_channel = {"kind": row.kind, "seconds": row.seconds, "channel": row.channel, "unit": row.unit}
            for e in row.errors:
                found = e.against_reference
                ratio = {n: None if found is None else getattr(found, n) for n in RATIO}
                own = {"model": names[e.model], "rms": e.rms, "fit": e.fit}
                own |= {"inside_95": e.inside_95, "intervals": e.intervals}
                rows.append({**of_channel, **own, **ratio, "best": e.model == row.best})
        frame = import_library("pandas").DataFrame(rows)
        numbers = ["seconds", "rms", "fit", "inside_95", "ratio", "low", "high", "blocks"]
        return frame.astype(dict.fromkeys(numbers, float))

    def predictions(self) -> ComparedPredictions:
        """Return the predictions of all models over each horizon and in simulation, with the measured samples.

        They are those of `plot`. There are none one step ahead. A simulation filters the first 15 s of a record, or of
        each block if the logs are cut into blocks. Its samples of that time are left out, as the filter has seen them,
        so that `Prediction.rms` is the error of the tables where all models predict the same samples.

        Returns
        -------
        ComparedPredictions
            ``predictions[model][horizon][record][channel]`` is a `Prediction`: ``model`` is the name of a model, and
            ``horizon`` a time [s] or ``"simulation"``. `to_pandas` gives one table of all. ``sd`` is that for a run
            which the model has not seen: widened by the validation data of its fit, over their horizon and in
            simulation. It is the model's own over other horizons, and without validation data
            (`ComparedModel.widened_horizons`). ``predicted`` is NaN from the time on at which a prediction diverged.
            ``measured`` is interpolated if the rows of the models differ. Angles are not wrapped: the
            prediction is within half a turn of the sample.
        """
        names = {m.label: m.name for m in self.result.models}
        found = ComparedPredictions(m.name for m in self.result.models)
        for x in self.result.traces:
            for p in x.predictions:
                t, predicted, sd = p.t[p.unseen], p.predicted[p.unseen], p.sd[p.unseen]
                measured = np.interp(t, x.t, x.measured, left=np.nan, right=np.nan)
                horizon: float | Literal["simulation"] = "simulation" if p.seconds is None else p.seconds
                by_record = found[names[p.model]].setdefault(horizon, ByRecord[Prediction]())
                if x.angle:
                    predicted = measured - wrap(measured - predicted, True)
                samples = Prediction(t, measured, predicted, sd, x.unit)
                if x.record not in by_record:
                    by_record[x.record] = {}
                by_record[x.record][x.channel] = samples
        return found

    def residuals(self, model: str | None = None) -> ByRecord[Series]:
        """Return the standardised residuals of a model one step ahead on the compared logs, by record and channel.

        They are innovations divided by their standard deviations, without outliers, as `FittedVehicle.residuals`. The
        filter of a comparison is of first order, so that they may differ a little from those of the fit. A channel
        with fewer than 60 samples in a record is missing.

        Parameters
        ----------
        model : str, optional
            Name of the model, one of `names`. None: the first one.

        Returns
        -------
        ByRecord of Series
            By record and channel; `to_pandas` gives one table of all. White noise of variance 1 if the model is
            complete.

        Raises
        ------
        SeatrialError
            If there is no model of this name, or if the comparison has no residuals, as one of logs that are cut into
            blocks of time.
        """
        found = ByRecord[Series]()
        for row in self._with_residuals(model).residuals:
            if row.record not in found:
                found[row.record] = {}
            found[row.record][row.channel] = Series(row.t, row.e)
        return found

    def residual_tests(self, model: str | None = None) -> Any:
        """Return the tests of the `residuals` as a ``pandas.DataFrame`` with a row for each test.

        The tests are those of whiteness, of normality and of the correlation with each input. The index and the columns
        are those of `FittedVehicle.residual_tests`.

        Parameters
        ----------
        model : str, optional
            Name of the model, one of `names`. None: the first one.

        Raises
        ------
        SeatrialError
            As `residuals`, or if pandas is not installed.
        """
        return tables.residual_frame(self._with_residuals(model), "validation")

    def plot_residuals(self, *channels: str, model: str | None = None) -> Figure:
        """Return a figure of the `residuals` over time, with lines at ± 2.

        Parameters
        ----------
        *channels : str
            Names of the channels to draw, such as ``"psi"``; without names all are drawn.
        model : str, optional
            Name of the model, one of `names`. None: the first one.

        Raises
        ------
        SeatrialError
            As `residuals`, or if there is no channel with one of the names.
        """
        from seatrial.api.plots import residual_figure

        return residual_figure(self.residuals(model), channels)

    def _with_residuals(self, model: str | None) -> ComparedModel:
        """Return the row of a model by its name; None: the first one. SeatrialError if it has no residuals."""
        rows = NamedValues({m.name: m for m in self.result.models}, "model")
        row = self.result.models[0] if model is None else rows[model]
        if not row.residuals:
            raise SeatrialError(
                "this comparison has no residuals: its logs are cut into blocks of time or have fewer than 60 samples "
                "of each channel, or it was made by an earlier version of seatrial; compare again with st.compare"
            )
        return row

    def plot(self, *channels: str, horizon: float | Literal["simulation"] | None = None) -> Figure:
        """Return a figure of the measured channels with the predictions of all models, each with its 95 % band.

        It has a panel for each channel of each record. Each model has its own colour and dash, which are
        distinguishable with any kind of colour vision. Angles are in degrees.

        Parameters
        ----------
        *channels : str
            Names of the channels to draw, such as ``"psi"``; without names all are drawn.
        horizon : float or ``"simulation"``, optional
            Horizon of the predictions [s], one of those of the comparison, or the simulation from the inputs alone.
            None: the first horizon.

        Raises
        ------
        SeatrialError
            If the comparison has no channel with one of the names, or no such horizon.
        """
        from seatrial.api.plots import comparison_figure

        return comparison_figure(self.result, channels, horizon)

    def save(self, folder: PathLike) -> Path:
        """Write result.json and report.html to a folder, as ``seatrial ident compare --out``, and return its path.

        Parameters
        ----------
        folder : path
            Folder, which is created if it does not exist. Existing files of the same names are replaced.
        """
        from seatrial.ident.workflows.compare import write_comparison

        return write_comparison(self.result, output_folder(folder))

    def _content(self) -> Content:
        """Return the answer, the warnings, and the RMS errors over the first horizon.

        The errors have a row for each channel and a column for each model. Angles are in degrees.
        """
        from seatrial.ident.report.formatting import degrees_for

        labels, horizon = [m.label for m in self.result.models], self.result.horizons[0]
        rows = []
        for row in self.result.channels:
            if row.seconds == horizon:
                factor, unit = degrees_for(row.unit)
                rms = {e.model: None if e.rms is None else factor * e.rms for e in row.errors}
                rows.append((row.channel, *(number(rms.get(label), 3) for label in labels), unit or "1"))
        names = tuple(m.name for m in self.result.models)
        return Content(
            self.answer, tables.warning_texts(self.result), (f"RMS error {horizon:g} s ahead", *names, "unit"), rows
        )

    def __repr__(self) -> str:
        """Return the text of `summary`, which the interpreter shows."""
        return self.summary()


@overload
def compare(
    models: Models,
    logs: Logs,
    /,
    *,
    horizon: float | Sequence[float] | None = None,
    rate: float | None = None,
    thruster: PathLike | None = None,
    backend: Literal["loky", "dask", "ray"] = "loky",
    scheduler: str = "",
    jobs: int | None = None,
) -> Comparison: ...


@overload
def compare(
    models: AnyModel,
    *others: Any,
    logs: Logs | None = None,
    horizon: float | Sequence[float] | None = None,
    rate: float | None = None,
    thruster: PathLike | None = None,
    backend: Literal["loky", "dask", "ray"] = "loky",
    scheduler: str = "",
    jobs: int | None = None,
) -> Comparison: ...


@named_arguments
def compare(
    models: Any,
    *others: Any,
    logs: Logs | None = None,
    horizon: float | Sequence[float] | None = None,
    rate: float | None = None,
    thruster: PathLike | None = None,
    backend: Literal["loky", "dask", "ray"] = "loky",
    scheduler: str = "",
    jobs: int | None = None,
) -> Comparison:
    """Evaluate a fitted model on logs that it has not seen, or compare several: errors by channel and horizon.

    The call is ``compare(model, logs)`` for one model, whose fit and 95 % intervals are judged. It is
    ``compare([m1, m2], logs)`` with a list or dictionary of models, or ``compare(m1, m2, logs)`` with one model after
    the other: the last argument without a name is then the logs.

    Parameters
    ----------
    models : sequence, or dict by name, of path, `Saved`, `FittedVehicle` or `FittedDiagnosis`; or the first of them
        One model to evaluate, or several to compare; the first one is then the reference. A path that occurs twice
        counts once.
    *others : models and logs
        Further models if ``models`` is a single one, and then the logs if ``logs`` is not given by its name.
    logs : path, `Log` or sequence of them, optional
        Logs that the models predict; of a `Log`, its window is used. Use logs that no model was fitted to; the
        summary names the others.
    horizon : float or sequence of float, optional
        Horizons of the predictions [s], beside one step ahead and simulation. None: that of the first model.
    rate : float, optional
        Rate of the rows [Hz] to which faster sensors are averaged. None: the usual rate of the first model.
    thruster : path, optional
        File of the static curve from command to thrust with which the models were fitted.
    backend : ``loky``, ``dask`` or ``ray``
        Processes of this computer, or a Dask or Ray cluster. Each predicts one log by one model at a time.
    scheduler : str
        Address of the scheduler of a Dask cluster, or of the head of a Ray cluster; empty: one is started on this
        computer.
    jobs : int, optional
        Number of processes on this computer; -1: one for each core. None: this process; of a cluster that is started
        here, one for each core.

    Returns
    -------
    Comparison
        Errors of each model, the shares of them inside its 95 % intervals, and the differences between the models.

    Raises
    ------
    SeatrialError
        If there are no models or no logs, if a model is given twice and no other one, if a log is given as a model, if
        a model does not go with the logs, if the logs have faults that make a fit meaningless, or if none is longer
        than ``horizon``.

    Examples
    --------
    >>> print(st.compare("vehicle", "run4.mcap").answer)
    >>> compared = st.compare({"nominal": fit, "with mismatch": found}, "run4.mcap", horizon=[2.0, 10.0])
    >>> compared.plot("psi", "r", horizon="simulation").save("overlay.html")
    >>> st.compare("vehicle", "diagnosis", "run4.mcap").best
    """
    from seatrial.ident.parallel import Workers
    from seatrial.ident.workflows.compare import CompareRequest, compare_models

    chosen, data = _models_and_logs(models, others, logs)
    for model in chosen.values() if isinstance(chosen, Mapping) else chosen:
        refuse_log(model)
    named = chosen if isinstance(chosen, Mapping) else {_name_of(m, k): m for k, m in enumerate(chosen)}
    several = isinstance(horizon, Sequence | np.ndarray) and not isinstance(horizon, str)
    horizons = tuple(cast(Any, horizon)) if several else () if horizon is None else (cast(float, horizon),)
    for seconds in horizons:
        check_above_zero("horizon", seconds)
    if rate is not None:
        check_rate(rate)
    with errors_of_users(), ExitStack() as stack:
        if len(named) == 1 < len(chosen):
            raise SeatrialError(f"{next(iter(named))} is given twice; give another model to compare it with")
        if not named:
            raise SeatrialError("there is no model; give one, or several as a list, and then the logs")
        paths = [stack.enter_context(model_path(m)) for m in named.values()]
        (files,) = as_logs(data)
        request = CompareRequest(
            paths,
            files,
            horizons,
            rate,
            None if thruster is None else str(as_path(thruster, "thruster")),
            window=window_of(data),
            names=tuple(named),
            workers=Workers(jobs, backend, scheduler),
        )
        messages = Messages()
        arguments = {"models": chosen, "logs": data, "horizon": horizon, "rate": rate, "thruster": thruster}
        command = python_call(compare, {**arguments, "backend": backend, "scheduler": scheduler, "jobs": jobs})
        result = compare_models(request, command, messages)
    warn_of_result(result, messages)
    return Comparison(result)


def _models_and_logs(models: Any, others: Sequence[Any], logs: Logs | None) -> tuple[Models, Logs]:
    """Return the models and the logs of the arguments of `compare`.

    `models` is a sequence or dictionary of models, or the first model. A path, also as text, is a model. `others` are
    the further arguments without a name.

    Raises
    ------
    SeatrialError
        If there are no logs, or if a list of models is followed by more than the logs.
    """
    several = isinstance(models, Mapping | Sequence) and not isinstance(models, str | bytes | Log)
    rest = list(others)
    if logs is None:
        if not rest:
            raise SeatrialError("there are no logs; give them after the models, as in compare([m1, m2], logs)")
        logs = rest.pop()
    if not several:
        return [models, *rest], logs
    if rest:
        raise SeatrialError(
            "a list of models is followed by the logs alone; give the models one after the other, or in the list, and "
            "options by their names, such as horizon=10"
        )
    return models, logs


def _name_of(model: AnyModel, index: int) -> str:
    """Return a name for a model: its path as text, or "model 2" for a fitted model with the `index` 1 (from 0).

    The path of a `Saved` is that from which it was loaded. A model that is neither is taken as a path and not checked.
    """
    from seatrial.api.loading import Saved

    if isinstance(model, Saved):
        return str(model.path)
    return f"model {index + 1}" if isinstance(model, FittedResult) else str(model)
