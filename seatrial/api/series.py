"""Values over time for the Python interface: signals, predictions, and their tables in pandas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.errors import NamedValues, counted
from seatrial.daq.log import import_library


class Series(NamedTuple):
    """Values over time of one signal, for example of a state, an output or a residual.

    Attributes
    ----------
    t : Array (n,)
        Times [s] from the start of the log; of a simulation for given inputs, in the time ``t`` of the inputs.
    value : Array (n,)
        Values at these times.
    """

    t: NDArray[np.float64]
    value: NDArray[np.float64]

    def __repr__(self) -> str:
        """Return one line with the number of values and the times of the first and the last."""
        return f"Series({_span(self.t)})"

    def to_pandas(self) -> Any:
        """Return the values as a ``pandas.Series``, whose index is the time [s].

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        return pandas.Series(self.value, index=pandas.Index(self.t, name="t"))


class Prediction(NamedTuple):
    """Measured samples of one channel of a record, and their predictions by a model.

    Attributes
    ----------
    t : Array (n,)
        Times of the samples [s], in the time of the record.
    measured : Array (n,)
        Samples, in the unit of the channel.
    predicted : Array (n,)
        Predictions of these samples, in the same unit; infinite if the prediction diverged.
    sd : Array (n,)
        Standard deviations of measured minus predicted, in the same unit. Over a horizon and in simulation they are
        widened by what the validation data show, so that ``predicted`` ± 1.96 ``sd`` contains about 95 % of further
        samples. NaN if a channel has no such forecast.
    unit : str
        Unit of the channel, SI and radians; empty if it has none or if it is unknown.
    """

    t: NDArray[np.float64]
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]
    sd: NDArray[np.float64]
    unit: str = ""

    @property
    def rms(self) -> float:
        """Root mean square of measured minus predicted, in the unit of the channel; NaN without samples.

        It is infinite if a prediction diverged. Errors of angles are within half a turn.
        """
        return float(np.sqrt(np.mean((self.measured - self.predicted) ** 2)))

    def __repr__(self) -> str:
        """Return one line with the number of samples, the first and last time, and the RMS error with its unit."""
        error = f", RMS error {self.rms:.3g} {self.unit}".rstrip() if self.t.size else ""
        return f"Prediction({_span(self.t)}{error})"

    def to_pandas(self) -> Any:
        """Return measured, predicted and sd as the columns of a ``pandas.DataFrame``, whose index is the time [s].

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        columns = {name: getattr(self, name) for name in ("t", "measured", "predicted", "sd")}
        return pandas.DataFrame(columns).set_index("t")


def _span(t: NDArray[np.float64]) -> str:
    """Return the number of samples in words, and the times [s] of the first and the last, if there are any."""
    return counted(t.size, "sample") + (f", {t[0]:.6g} to {t[-1]:.6g} s" if t.size else "")


T = TypeVar("T", Series, Prediction)


class ByRecord(NamedValues[dict[str, T]]):
    """Residuals or predictions: a dict by record of a dict by channel, which also makes a table in pandas.

    An unknown record or channel raises `UnknownName`, a KeyError, with the names that exist.

    Parameters
    ----------
    values : dict of str to dict, optional
        The values by record and channel.
    """

    def __init__(self, values: Mapping[str, Mapping[str, T]] | None = None) -> None:
        """Copy the values."""
        super().__init__({}, "record")
        for record, channels in (values or {}).items():
            self[record] = channels

    def __setitem__(self, record: str, channels: Mapping[str, T]) -> None:
        """Store a copy of the channels of a record."""
        named: Any = NamedValues(channels, f"channel of {record}")
        super().__setitem__(record, named)

    def to_pandas(self) -> Any:
        """Return all values as a ``pandas.DataFrame`` with a row for each sample.

        The columns are ``record``, ``channel`` and ``t`` [s], and then those of the values: ``value`` of residuals;
        ``measured``, ``predicted``, ``sd`` and ``unit`` of predictions.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        parts = [
            pandas.DataFrame({"record": record, "channel": channel, **values._asdict()})
            for record, channels in self.items()
            for channel, values in channels.items()
        ]
        return pandas.concat(parts, ignore_index=True) if parts else pandas.DataFrame(columns=["record", "channel"])


class ComparedPredictions(NamedValues[dict[float | Literal["simulation"], ByRecord[Prediction]]]):
    """Predictions of several models: a dict by name of the model of a dict by horizon, which also makes a table.

    A horizon is a time [s], or ``"simulation"``. For each, the predictions are a `ByRecord`: by record and channel.

    Parameters
    ----------
    names : iterable of str
        Names of the models, for which the dict begins without predictions.
    """

    def __init__(self, names: Iterable[str]) -> None:
        """Begin without predictions."""
        found: Any = {name: NamedValues({}, f"horizon of {name}") for name in names}
        super().__init__(found, "model")

    def to_pandas(self) -> Any:
        """Return all predictions as a ``pandas.DataFrame`` with a row for each predicted sample.

        The columns are ``record``, ``model`` (its name), ``kind`` (horizon or simulation), ``horizon`` [s] (NaN: a
        simulation), ``channel``, ``t`` [s], ``measured``, ``predicted``, ``sd`` and ``unit``.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        first = ["record", "model", "kind", "horizon", "channel"]
        parts = []
        for model, by_horizon in self.items():
            for horizon, found in by_horizon.items():
                simulated = horizon == "simulation"
                about = {"kind": "simulation" if simulated else "horizon", "horizon": np.nan if simulated else horizon}
                parts.append(found.to_pandas().assign(model=model, **about))
        if not parts:
            return pandas.DataFrame(columns=first)
        table = pandas.concat(parts, ignore_index=True)
        return table[[*first, *(c for c in table.columns if c not in first)]]


class Simulation(NamedValues[Series]):
    """Simulated states and outputs: a dict by name, which also makes a table in pandas. `simulate` returns it.

    Parameters
    ----------
    values : dict of str to Series
        The signals by name.
    """

    def __init__(self, values: Mapping[str, Series]) -> None:
        """Copy the signals."""
        super().__init__(values, "state or output")

    def to_pandas(self) -> Any:
        """Return all signals as the columns of a ``pandas.DataFrame``, whose index is the time [s].

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        return pandas.DataFrame({name: signal.to_pandas() for name, signal in self.items()})
