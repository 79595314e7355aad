"""Comparison of fitted models on the same logs, for the Python interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from seatrial.api.fits import FittedResult, Logs, model_path, window_of
from seatrial.api.logs import as_paths
from seatrial.api.messages import Messages, errors_of_users
from seatrial.api.shown import Content, Shown, number
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import import_library

if TYPE_CHECKING:
    from seatrial.ident.workflows.compare import ModelComparison

AnyModel = Any  # PathLike, FittedVehicle, FittedDiagnosis or Saved, which is imported only if it is needed
Models = Sequence[AnyModel] | Mapping[str, AnyModel]


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Comparison of fitted models by their prediction errors on the same logs. `compare` returns it.

    Attributes
    ----------
    names : tuple of str
        Name of each model; the first one is the reference.
    found : ModelComparison
        Prediction errors of each model, and their differences from the first one (`seatrial.ident.workflows.compare`).
    """

    names: tuple[str, ...]
    found: ModelComparison

    @property
    def best(self) -> str:
        """Name of the model with the smallest prediction error over the horizon.

        Only models that are significantly better than the first one are considered: the 95 % interval of the change of
        the prediction error excludes no change. If there are none, it is the first.
        """
        better = [
            (m.change.ratio, name)
            for name, m in zip(self.names, self.found.models, strict=True)
            if m.change is not None and m.change.verdict == "fell"
        ]
        return min(better)[1] if better else self.names[0]

    def summary(self) -> str:
        """Return the comparison as text: RMS errors by channel, then the difference of each model to the first one."""
        from seatrial.ident.workflows.compare import comparison_lines

        return "\n".join(comparison_lines(self.found, self.names))

    def to_pandas(self) -> Any:
        """Return the RMS prediction errors as a ``pandas.DataFrame``: a row for each channel, a column for each model.

        A channel that a model does not predict is NaN.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        columns = {name: dict(m.rms) for name, m in zip(self.names, self.found.models, strict=True)}
        return import_library("pandas").DataFrame(columns)

    def _content(self) -> Content:
        """Return the best model, and the RMS prediction errors: a row for each channel, a column for each model."""
        rows = [
            (channel, *(number(m.rms.get(channel), 3) for m in self.found.models), unit or "1")
            for channel, unit in self.found.units.items()
        ]
        answer = f"Smallest prediction error {self.found.horizon:g} s ahead: {self.best}."
        return Content(answer, (), ("RMS error", *self.names, "unit"), rows)

    def __repr__(self) -> str:
        """Return the text of `summary`, which the interpreter shows."""
        return self.summary()


def compare(
    models: Models,
    logs: Logs,
    horizon: float | None = None,
    rate: float | None = None,
) -> Comparison:
    """Compare fitted models on the same logs: their prediction errors, and their log score one step ahead.

    Parameters
    ----------
    models : sequence, or dict by name, of path, `Saved`, `FittedVehicle` or `FittedDiagnosis`
        Two models or more; the first one is the reference. A path that occurs twice in a sequence counts once.
    logs : path, `Log` or sequence of them
        Logs on which the models are compared; of a `Log`, its window is used. Use logs that no model was fitted to; the
        summary names the others.
    horizon : float, optional
        Horizon of the predictions [s]. None: that of the first model.
    rate : float, optional
        Rate of the rows [Hz] to which faster sensors are averaged. None: the usual rate of the first model.

    Returns
    -------
    Comparison
        Errors of each model and the differences with their 95 % intervals.

    Raises
    ------
    SeatrialError
        If there are fewer than two different models, if a model does not go with the logs, if the logs have faults that
        make a fit meaningless, or if none is longer than ``horizon``.

    Examples
    --------
    >>> st.compare({"nominal": fit, "with mismatch": found}, "run4.mcap")
    """
    from seatrial.ident.workflows.compare import CompareRequest, compare_models

    named = models if isinstance(models, Mapping) else {_name_of(m, k): m for k, m in enumerate(models)}
    with errors_of_users(), ExitStack() as stack:
        if len(named) == 1 < len(models):
            raise SeatrialError(f"{next(iter(named))} is given twice; give another model to compare it with")
        paths = [stack.enter_context(model_path(m)) for m in named.values()]
        request = CompareRequest(paths, as_paths(logs), horizon, rate, window=window_of(logs))
        found = compare_models(request, Messages(False))
    return Comparison(tuple(named), found)


def _name_of(model: AnyModel, index: int) -> str:
    """Return a name for a model: its path as text, or "model 2" for a fitted model with the `index` 1 (from 0).

    The path of a `Saved` is that from which it was loaded. A model that is neither is taken as a path and not checked.
    """
    from seatrial.api.loading import Saved

    if isinstance(model, Saved):
        return str(model.path)
    return f"model {index + 1}" if isinstance(model, FittedResult) else str(model)
