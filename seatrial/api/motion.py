"""Steady motion and linear models of a fitted boat, for the Python interface: tables and figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from seatrial.api.arguments import as_path, check_number, named_arguments, shortened
from seatrial.api.figures import Figure
from seatrial.api.fits import FittedResult, model_path
from seatrial.api.loading import Saved
from seatrial.api.logs import PathLike
from seatrial.api.messages import errors_of_users
from seatrial.api.shown import Content, Shown, number
from seatrial.daq.errors import SeatrialError, counted, warn
from seatrial.daq.log import import_library
from seatrial.ident.export import (
    Bode,
    Inputs,
    LinearModel,
    cell_array,
    check_mat_name,
    conditions_text,
    heading_sentence,
    is_shortest_lag,
    pole_text,
    time_text,
    turn_sentence,
    write_mat,
)
from seatrial.ident.model import THRUSTER_FORCE, drive_word, is_of_thruster
from seatrial.ident.numerics import is_undetermined

if TYPE_CHECKING:
    from seatrial.ident.estimation import ParameterCovariance
    from seatrial.ident.model import Model
    from seatrial.ident.results import SteadyCurve

SMALL_PART = 0.1  # of the largest value of a curve; the errors of smaller values are compared with it
POINTS = 600  # largest number of points of a line
STEP = 0.1  # size of a step of the command, in a figure


def _determined(value: float, error: float, words: str) -> str:
    """Return the text of a value, or ``not determined`` if its standard error is more than half of its size."""
    return "not determined" if is_undetermined(value, error) else words


def _time_cell(constant: float, error: float) -> str:
    """Return the cell of a time constant [s]; of an unstable pole how fast it grows.

    The shortest lag of the model is marked by ``≤``: the lag of the boat may be shorter.
    """
    value = f"{'≤ ' * is_shortest_lag(constant)}{number(constant)}"
    return _determined(constant, error, time_text(constant, error) if constant < 0.0 else value)


@dataclass(frozen=True, repr=False)
class Linearisation(Shown, LinearModel):
    """Linear model of a boat about straight motion in still water, with its table and figures. `linearise` returns it.

    Its equation is ``dx/dt = A (x - x0) + B (u - u0)``; the attributes are those of this equation.

    Attributes
    ----------
    speed : float
        Forward speed through the water [m/s].
    states, inputs : tuple of str
        Names of the n states and m inputs. The states are the velocities, and those on which these depend, such as
        those of shafts. States of sensors, such as the filter of a compass, are not among them.
    A : Array (n, n)
        Derivatives of the rates by the states [1/s, if both have the same unit].
    B : Array (n, m)
        Derivatives of the rates by the inputs.
    x0 : Array (n,)
        States of the operating point.
    u0 : Array (m,)
        Inputs that keep the operating point.
    delays : dict of str to float
        Dead time [s] of each input that the model delays. The matrices do not contain it; all responses do.
    units : dict of str to str
        Unit of each state and input by name; empty for a number without unit.
    by_heading : Array (n,)
        Derivatives of the rates by the heading, which A does not contain. They are zero unless the model depends on
        the heading, as by wind. `lqr` uses them.
    conditions : dict of str to float
        Conditions that the model takes as constant: time ``t`` [s] since the start of a run, ``work`` of the thrusters,
        place ``x`` and ``y`` [m], heading ``psi`` [rad]. Empty if the model depends on none of them.
    assumed : tuple of str
        Names of the conditions whose value is a default, because ``at`` did not have them.
    ranges : dict of str to tuple of float
        Smallest and largest value of the states and inputs in the fitted data by name. `outside` lists those of the
        operating point that leave them. Empty if the model has no ranges.
    """

    def to_pandas(self) -> Any:
        """Return the poles as a ``pandas.DataFrame`` with a row for each, in the order of `poles`.

        Those of the boat come first, then those of its thrusters, then those of waves, sensors and other states.

        The columns are real, imaginary [1/s], time_constant [s], se (its standard error; NaN if unknown), frequency
        [Hz], damping (ratio, 1 for a real stable pole) and mainly (the states that take most part in it). An unstable
        pole has no time constant (NaN): it grows by a factor of e in the time 1 / real. The shortest lag of a state is
        0.05 s: a lag with a shorter time constant, such as ``T_n`` = 0, has this pole too.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        poles, size, grows = self.poles, np.abs(self.poles), self.poles.real > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            damping = np.where(size > 0.0, -poles.real / size, np.nan)
        columns = {
            "real": poles.real,
            "imaginary": poles.imag,
            "time_constant": np.where(grows, np.nan, self.time_constants),
            "se": np.where(grows, np.nan, self.time_constant_errors),
            "frequency": size / (2.0 * np.pi),
            "damping": damping,
            "mainly": list(self.mainly),
        }
        frame = import_library("pandas").DataFrame(columns)
        frame.index.name = "pole"
        return frame

    def to_mat(self, path: PathLike, force: bool = False) -> Path:
        """Write the linear model to a MATLAB file, for ``ss(A, B, C, D)`` after ``load``, and return its path.

        The file has these variables:

        - A, B, C, D, and x0 and u0 as columns;
        - states, inputs, outputs: cell arrays of the names. The outputs are the states;
        - state_units, input_units: cell arrays of the units, "1" for a number without a unit;
        - input_delay [s]: dead time of each input, which the matrices do not contain;
        - by_heading: derivatives of the rates by the heading;
        - A_se, B_se, x0_se, u0_se: standard errors; NaN if those of the estimates are unknown;
        - speed [m/s], and the struct conditions.

        Parameters
        ----------
        path : path
            The file, whose name ends in .mat.
        force : bool
            Whether an existing file is replaced.

        Raises
        ------
        SeatrialError
            If the name does not end in .mat, if the file exists and ``force`` is False, or if scipy is not installed.
        """
        from seatrial.daq.files import require_new

        file = as_path(path, "path")
        check_mat_name(file)
        with errors_of_users():
            require_new(file, force, "path")
            write_mat(file, self._variables(), force)
        return file

    def _variables(self) -> dict[str, Any]:
        """Return the variables of the MATLAB file by name."""
        values = {name: np.asarray(getattr(self, name)) for name in ("A", "B", "x0", "u0")}
        errors = {f"{n}_se": self.error_of(v, [getattr(m, n) for m in self.moved]) for n, v in values.items()}
        # An empty struct would be read as a struct with one element.
        conditions = {"conditions": dict(self.conditions)} if self.conditions else {}
        return {
            **values,
            **errors,
            "C": self.C,
            "D": self.D,
            "states": cell_array(self.states),
            "inputs": cell_array(self.inputs),
            "outputs": cell_array(self.outputs),
            "state_units": cell_array(self.units[n] or "1" for n in self.states),
            "input_units": cell_array(self.units[n] or "1" for n in self.inputs),
            "input_delay": np.array([self.delays.get(n, 0.0) for n in self.inputs]),
            "by_heading": self.by_heading,
            "speed": self.speed,
            **conditions,
        }

    def step_response(self, inputs: Inputs, t: ArrayLike | None = None) -> dict[str, NDArray[np.float64]]:
        """Return the response of each state to a unit step of the inputs at t = 0, with their dead time.

        Parameters
        ----------
        inputs : str, or dict of str to float
            Name of an input or of one of the `motions`, or a weight for each of several of these names.
        t : Array (n_times,) or float, optional
            Times [s], at least 0. None: `times`. One number is the end of 200 equidistant times from 0 on.

        Returns
        -------
        dict of str to Array (n_times,)
            Change of each state from the operating point, for a step of one unit of the inputs, in SI units and
            radians. The values are plain arrays, and no series with ``.value`` as of `simulate`, `predict` and
            `residuals`: their times are ``t``.

        Raises
        ------
        SeatrialError
            If the model has no such input, if ``inputs`` is neither a name nor a dict of weights, or if a time is no
            number of at least 0.

        Warns
        -----
        SeatrialWarning
            If a pole is unstable. The response then grows without limit, which no boat does: it is valid only while the
            changes are small.
        """
        found = super().step_response(inputs, t)
        self._warn_of_growth()
        return found

    def _warn_of_growth(self) -> None:
        """Warn that a step response grows without limit, if a pole is unstable."""
        if rate := self.growth:
            warn(
                f"the linear model at {self.speed:g} m/s is unstable: its step response grows by a factor of e in "
                f"{1.0 / rate:.3g} s without limit, which no boat does; use it only while the changes are small"
            )

    def plot_step(self, inputs: Inputs | None = None, size: float = STEP, t: ArrayLike | None = None) -> Figure:
        """Return a figure of the step responses, with a panel for each state that responds, and 95 % bands.

        Parameters
        ----------
        inputs : str, or dict of str to float, optional
            Name of an input or of one of the `motions`, or a weight for each of several inputs. None: all `motions`.
        size : float
            Size of the step, in the unit of the inputs. The linear model holds for small steps.
        t : Array (n_times,), optional
            Times [s], at least 0, or the end of them. None: `times`.

        Raises
        ------
        SeatrialError
            If the model has no such input, or if ``size`` or a time is no number.

        Warns
        -----
        SeatrialWarning
            If a pole is unstable, so that the response grows.
        """
        from seatrial.ident.report import Panel, band, degrees_for, line_trace, stacked

        check_number("size", size, "the unit of the inputs")
        at = self.response_times(t)
        self._warn_of_growth()
        panels, shown = [], dict[str, None]()
        for name, chosen in self._chosen(inputs).items():
            found = super().step_response(chosen, at)
            moved = [m.step_response(chosen, at) for m in self.moved]
            for state in self.responding(chosen):
                factor, unit = degrees_for(self.units[state])
                value = factor * size * found[state]
                panel = Panel(f"{state} [{unit or '1'}] after a step of {size:g}: {name}", y={"rangemode": "tozero"})
                if moved:
                    sd = factor * size * self.error_of(found[state], [m[state] for m in moved])
                    panel.traces.append(band(at, value, 1.96 * np.abs(sd), POINTS))
                panel.traces.append(line_trace(at, value, state, POINTS))
                panels.append(panel)
                shown[state] = None
        figure, height = stacked(panels, "time [s]")
        layout = figure["layout"] | {"height": height, "showlegend": False}
        return Figure(self._title("Step responses", shown, self._chosen(inputs)), figure["data"], layout)

    def plot_bode(self, inputs: Inputs | None = None, *states: str, frequency: ArrayLike | None = None) -> Figure:
        """Return a Bode plot: gain [dB] and phase [deg] over the frequency [Hz], with 95 % bands and the dead time.

        A gain of 0 dB is one unit of the state for one unit of the inputs. Rates are in deg/s.

        Parameters
        ----------
        inputs : str, or dict of str to float, optional
            Name of an input or of one of the `motions`, or a weight for each of several inputs. None: all `motions`.
        *states : str
            Names of the states; without names all that respond.
        frequency : Array (n_frequencies,), optional
            Frequencies [Hz], increasing and above 0. None: `frequencies`.

        Raises
        ------
        SeatrialError
            If the model has no such input, if a frequency is no number above 0, or if none of the states responds to
            the inputs.
        """
        from seatrial.ident.report import (
            DASHES,
            FREQUENCY,
            LINES,
            Panel,
            degrees_for,
            frequency_axis,
            gain_traces,
            phase_axis,
            phase_traces,
            stacked,
        )

        gain, phase, shown = Panel("gain [dB]"), Panel("phase [deg]"), list[Bode]()
        shown_states: dict[str, None] = {}
        for name, chosen in self._chosen(inputs).items():
            for state, bode in self.bode(chosen, frequency).items():
                if states and state not in states:
                    continue
                factor, unit = degrees_for(self.units[state])
                k = sum(1 for trace in phase.traces if trace.get("name"))
                style = {"color": LINES[k % len(LINES)], "dash": DASHES[k % len(DASHES)]}
                words = f"{state} [{unit or '1'}], {name}"
                gain.traces += gain_traces(bode.frequency, factor * bode.gain, bode.gain_sd, words, POINTS, **style)
                lines = phase_traces(bode.frequency, bode.phase, bode.phase_sd, words, POINTS, **style)
                phase.traces += [{**trace, "showlegend": False} for trace in lines]
                shown.append(bode)
                shown_states[state] = None
        if not gain.traces:
            asked = ", ".join(states) or "no state"
            raise SeatrialError(f"{asked}: does not respond to these inputs; the states are {', '.join(self.states)}")
        phase.y.update(phase_axis([b.phase for b in shown], [b.phase_sd for b in shown]))
        figure, height = stacked([gain, phase], FREQUENCY, panel_height=220)
        layout = _legend_below(figure["layout"], height)
        layout |= {"xaxis": layout["xaxis"] | frequency_axis()}
        return Figure(self._title("Bode plot", shown_states, self._chosen(inputs)), figure["data"], layout)

    def _chosen(self, inputs: Inputs | None) -> dict[str, Inputs]:
        """Return the inputs of a figure by the name that it shows; for None those of all motions."""
        if inputs is None:
            return dict(self.motions)
        weights = self._weights(inputs)
        words = inputs if isinstance(inputs, str) else ", ".join(f"{w:+g} {n}" for n, w in weights.items())
        return {words: weights}

    def _title(self, what: str, states: Iterable[str], inputs: Iterable[str]) -> str:
        """Return the title of a figure: ``Bode plot of r from turn at 0.6 m/s, heading 40 deg``."""
        words = f"{what} of {', '.join(states)} from {' and '.join(inputs)} at {self.speed:g} m/s"
        return f"{words}, heading {degrees(self.conditions['psi']):.4g} deg" if "psi" in self.conditions else words

    def _content(self) -> Content:
        """Return speed and stability, and the table of the poles."""
        at = ", ".join(f"{n} {number(v)}" for n, v in zip(self.inputs, self.u0, strict=True))
        rows = [
            (pole_text(pole), _time_cell(constant, se), "" if constant < 0.0 else number(se, 2), names)
            for pole, constant, se, names in zip(
                self.poles, self.time_constants, self.time_constant_errors, self.mainly, strict=True
            )
        ]
        answer = f"Linear model at {self.speed:g} m/s ({at}), {self.stability_text}."
        if self.conditions:
            answer += f" Taken as constant: {conditions_text(self.conditions)}."
        if words := heading_sentence(self.conditions):
            answer += f" {words}"
        if words := self.drift:
            answer += f" Operating point with {words}."
        notes = [f"The operating point is outside the fitted data: {self.outside}."] if self.outside else []
        return Content(answer, notes, ("pole [1/s]", "time constant [s]", "s.e. [s]", "mainly"), rows)


@dataclass(frozen=True, repr=False)
class Steady(Shown):
    """Steady speed and turn rate of a boat without current over constant commands. `steady` returns it.

    Attributes
    ----------
    curves : tuple of SteadyCurve
        The curve of the speed on a straight course, then one of the turn rate for each mean command
        (`seatrial.ident.results.SteadyCurve`): ``command``, ``value`` and its standard error ``sd``.
    conditions : dict of str to float
        Conditions that the motions take as constant, as those of a `Linearisation`.
    speeds : tuple of float or None
        Smallest and largest forward speed [m/s] in the data of the fit; None if unknown.
    turn_rates : tuple of float or None
        Smallest and largest turn rate [rad/s] in the data of the fit; None if unknown.
    """

    curves: tuple[SteadyCurve, ...]
    conditions: Mapping[str, float] = field(default_factory=dict)
    speeds: tuple[float, float] | None = None
    turn_rates: tuple[float, float] | None = None

    @property
    def straight(self) -> SteadyCurve | None:
        """Steady speed [m/s] over the mean command of both sides; None if the model has no forward speed.

        Its ``sides`` are the commands that hold the course.
        """
        return next((c for c in self.curves if c.motion == "straight"), None)

    @property
    def turns(self) -> tuple[SteadyCurve, ...]:
        """Steady turn rates [rad/s] over half the difference of left and right command, one for each mean command.

        Empty if the model has no turn rate or no thrusters of two sides, or if it depends on heading or place.
        """
        return tuple(c for c in self.curves if c.motion == "turn")

    @property
    def answer(self) -> str:
        """Largest steady speed and turn rate within the commands of the data, and the conditions, in sentences.

        A speed or turn rate beyond those of the data is marked. A sentence says why a model that depends on heading or
        place has no steady turn rate, and another one that ± is one standard error.
        """
        from seatrial.ident.report import held_course
        from seatrial.ident.results import standard_error_sentence

        words = {"u": ("speed", 1.0, "m/s"), "r": ("turn rate", np.degrees(1.0), "deg/s")}
        found = []
        for quantity, (name, factor, unit) in words.items():
            # The speed is that ahead, and the turn rate that to either side.
            size = np.abs if quantity == "r" else np.asarray
            best = [(np.nanmax(size(c.value)), c) for c in self.curves if c.quantity == quantity]
            if best:
                _, curve = max(best, key=lambda x: float(x[0]))
                k = int(np.nanargmax(size(curve.value)))
                value = factor * size(curve.value)[k]
                left, right = (number(float(side[k]), 2) for side in curve.sides)
                command = left if left == right else f"{left} left and {right} right"
                sd = factor * curve.sd[k]
                error = "" if np.isnan(sd) else f" ± {number(sd, 2)}"
                beyond = ""
                if quantity == "u" and self.speeds is not None and value > self.speeds[1]:
                    beyond = f", beyond {number(self.speeds[1], 2)} m/s, below which 99 % of the data are"
                if quantity == "r" and self.turn_rates is not None:
                    reached = factor * max(-self.turn_rates[0], self.turn_rates[1])  # to either side
                    if value > reached:
                        beyond = f", beyond ± {number(reached, 2)} deg/s, within which 98 % of the data are"
                drive = drive_word(curve.inputs)
                if is_undetermined(float(value), float(sd)):
                    found.append(
                        f"The largest steady {name} is not determined: its standard error is more than half of the "
                        f"estimate{beyond}."
                    )
                    continue
                found.append(
                    f"The largest steady {name} is {number(value, 3)}{error} {unit}, at a {drive} of {command}{beyond}."
                )
        if self.straight is not None:
            if held := held_course(self.straight):
                found.append(f"{held}.")
            if (self.straight.unstable & (self.straight.value > 0.0)).any():
                slowest = np.min(self.straight.value[self.straight.unstable & (self.straight.value > 0.0)])
                found.append(
                    f"From {number(slowest, 2)} m/s ahead the boat leaves a straight course without a controller."
                )
        if errors := standard_error_sentence(*found):
            found.append(errors)
        if not self.turns and any(len(c.inputs) > 1 for c in self.curves) and (why := turn_sentence(self.conditions)):
            found.append(why)
        if self.conditions:
            found.append(f"Taken as constant: {conditions_text(self.conditions)}.")
        return " ".join(found)

    def to_pandas(self) -> Any:
        """Return all curves as one ``pandas.DataFrame`` with a row for each command.

        The columns are motion (straight or turn), mean (mean command of a turn), command, left and right (commands of
        the sides), quantity (u or r), value, sd (its standard error), unit, and unstable (whether the boat leaves a
        straight course without a controller). A command without a steady motion has the value NaN.

        Raises
        ------
        SeatrialError
            If pandas is not installed.
        """
        pandas = import_library("pandas")
        frames = [
            pandas.DataFrame(
                {"motion": c.motion, "mean": c.mean, "command": c.command, "left": c.sides[0], "right": c.sides[1]}
                | {"quantity": c.quantity, "value": c.value, "sd": c.sd, "unit": c.unit, "unstable": c.unstable}
            )
            for c in self.curves
        ]
        return pandas.concat(frames, ignore_index=True)

    def plot(self) -> Figure:
        """Return a figure of the steady speed and the steady turn rates over the command, with 95 % bands.

        The line of the speed is dotted beyond the speeds of the data, and dashed where the boat leaves a straight
        course without a controller.
        """
        from seatrial.ident.report import DASHES, LINES, Panel, band, degrees_for, line_trace, stacked, trusted_lines

        panels: dict[str, Panel] = {}
        drive = drive_word(self.curves[0].inputs)
        for c in self.curves:
            factor, unit = degrees_for(c.unit)
            what = "speed" if c.motion == "straight" else "turn rate"
            straight = f"the mean {drive} of both sides" if len(c.inputs) > 1 else f"the {drive}"
            how = straight if c.motion == "straight" else "half the difference of both sides"
            panel = panels.setdefault(c.motion, Panel(f"steady {what} [{unit}] over {how}"))
            k = sum(1 for trace in panel.traces if trace.get("name"))
            color, name = LINES[k % len(LINES)], what if c.motion == "straight" else f"mean {drive} {c.mean:.2g}"
            if np.isfinite(c.sd).any():
                area = band(c.command, factor * c.value, 1.96 * factor * c.sd, POINTS, color=color, gaps=True)
                panel.traces.append({**area, "showlegend": False})
            if c.motion == "straight":
                open_course = c.unstable & np.isfinite(c.value)
                lines = trusted_lines(c.command, c.value, name, POINTS, self.speeds, color=color, unstable=open_course)
                panel.traces += [{**line, "showlegend": len(lines) > 1} for line in lines]
            else:
                dash = DASHES[k % len(DASHES)]
                panel.traces.append(line_trace(c.command, factor * c.value, name, POINTS, color=color, dash=dash))
        unit = "N" if is_of_thruster(self.curves[0].inputs[0], THRUSTER_FORCE) else "part of full"
        figure, height = stacked(list(panels.values()), f"{drive} [{unit}]", panel_height=220)
        words = f"Steady motion at {conditions_text(self.conditions)}" if self.conditions else "Steady motion"
        return Figure(words, figure["data"], _legend_below(figure["layout"], height))

    def _content(self) -> Content:
        """Return the answer, and a table of about ten commands of each curve."""
        rows, two_sided = [], any(len(c.inputs) > 1 for c in self.curves)
        for c in self.curves:
            name = "speed" if c.motion == "straight" else f"turn rate, mean {number(c.mean, 2)}"
            for k in np.unique(np.linspace(0, c.command.size - 1, 11).round().astype(int)):
                # A small value in the middle of the curve may have a large error in proportion, and still be known.
                size = max(abs(c.value[k]), SMALL_PART * float(np.nanmax(np.abs(c.value))))
                value = _determined(size, c.sd[k], number(c.value[k]))
                sides = [number(side[k], 3) for side in c.sides] if two_sided else []
                rows.append((name, number(c.command[k], 3), *sides, value, number(c.sd[k], 2), c.unit))
        drive = drive_word(self.curves[0].inputs) if self.curves else "command"
        sides = ["left", "right"] if two_sided else []
        return Content(self.answer, (), ("", drive, *sides, "value", "s.e.", "unit"), rows)

    def __repr__(self) -> str:
        """Return a short text for the interpreter: number of curves, and `answer`."""
        return f"<Steady: {counted(len(self.curves), 'curve')}>\n{self.answer}"


def _legend_below(layout: dict[str, Any], height: int) -> dict[str, Any]:
    """Return the layout of stacked panels of a total ``height`` [px], with a legend below them."""
    legend = {"orientation": "h", "y": -0.12, "yanchor": "top", "x": 0.0}
    margin = layout["margin"] | {"b": 80}
    return layout | {"height": height + 40, "showlegend": True, "legend": legend, "margin": margin}


@named_arguments
def linearise(
    model: PathLike | Saved | FittedResult, speed: float, at: Mapping[str, float] | None = None
) -> Linearisation:
    """Linearise a fitted model about straight motion at a constant forward speed, without current.

    Effects may depend on the time since the start of a run (a payload that shifts), the work of the thrusters, the
    place or the heading. They are no inputs: the linear model takes them as constant, and shows their values. In wind
    the inputs ``u0`` that hold a course change with the heading: give the heading that you steer as ``at``.

    Parameters
    ----------
    model : path, `Saved`, `FittedVehicle` or `FittedDiagnosis`
        The model.
    speed : float
        Forward speed through the water [m/s], not zero.
    at : dict of str to float, optional
        Values of the conditions by name: ``t`` [s], ``work``, ``x``, ``y`` [m], ``psi`` [rad]. The default of time and
        work is the end of the fitted data, which is after a change such as that of a payload. A model.toml without
        their range is taken 10 s after its change, or else at zero. The default of place and heading is zero.

    Returns
    -------
    Linearisation
        Matrices A and B with their states and inputs, the operating point, poles, time constants, and responses to
        steps and over the frequency. A speed outside those of the fitted data, other states and inputs of the
        operating point outside them, and a heading of more than one turn give a `SeatrialWarning`.

    Raises
    ------
    SeatrialError
        If the model has no forward speed, if the boat does not reach this speed, or if there is no condition of a name.

    Examples
    --------
    >>> at_half_a_metre = st.linearise("vehicle", 0.5)
    >>> at_half_a_metre.time_constants
    >>> at_half_a_metre.plot_bode("turn")
    >>> feedback = at_half_a_metre.lqr({"u": 4.0, "r": 1.0, "psi": 4.0})
    """
    from seatrial.ident.export import chosen_conditions, sway_slopes
    from seatrial.ident.export import linearise as about_speed

    _check_conditions(at)
    with errors_of_users():
        structure, ranges, known = _estimates(model)
        found = about_speed(structure, speed, known, chosen_conditions(structure, ranges, at))
    low, high = ranges.get("u", (-np.inf, np.inf))
    # A limit that the text rounds to the speed itself is not exceeded.
    if not min(low, float(f"{low:.3g}")) <= speed <= max(high, float(f"{high:.3g}")):
        text = (
            f"{speed:g} m/s is outside {low:.3g} to {high:.3g} m/s, within which 98 % of the speeds of the fitted data "
            "are; choose one of these"
        )
        warn(text)
    if (sway_slopes(structure, np.array([speed]), found.u0[None], found.conditions) > 0.0).any():
        warn(
            f"at {speed:g} m/s the estimated damping of sway without drift is negative, which no hull has: poles that "
            "are stable here need not be stable on another heading, and a controller can fail; record turns at this "
            "speed, or fit a model without the hull lift that causes it (fixed={'Y_uv': 0.0})"
        )
    assumed = tuple(n for n in found.conditions if n not in (at or {}))
    linear = Linearisation(**{**vars(found), "assumed": assumed, "ranges": ranges})
    beside = {n: v for n, v in linear.ranges.items() if n != "u"}  # the speed has a warning of its own
    if words := replace(linear, ranges=beside).outside:
        warn(
            f"the operating point at {speed:g} m/s is outside the fitted data: {words}; the model extrapolates there: "
            "record data at it, or choose another speed or heading (at={'psi': ...})"
        )
    return linear


@named_arguments
def steady(
    model: PathLike | Saved | FittedResult,
    means: Sequence[float] | None = None,
    points: int = 41,
    at: Mapping[str, float] | None = None,
) -> Steady:
    """Compute the steady speed and the steady turn rate of a fitted model over constant commands, without current.

    The commands are those of the fitted data, ahead and astern, of each side. Disturbance forces and the current are
    left out. On a straight course the command is the mean of both sides, and their difference is that at which the
    boat does not turn: with thrusters of unequal strength, equal commands give no straight motion. Such a motion may
    leave the course without a controller, which ``unstable`` of the curve says. A speed and a turn rate at a command
    without a steady motion, or with one that is unstable in any other way, are NaN. A model that depends on the
    heading or the place, as by wind, has a steady speed for one heading and place (``at``), and no steady turn rate: a
    turning boat keeps neither of them.

    Parameters
    ----------
    model : path, `Saved`, `FittedVehicle` or `FittedDiagnosis`
        The model.
    means : sequence of float, optional
        Means of the left and the right command in turns, as parts of the largest command, 0 to 1: 0 is a turn on the
        spot. None: 0, 0.5, and the mean with the largest difference of both sides in the data, if it is another one,
        as with thrust astern that is smaller than thrust ahead.
    points : int
        Number of commands of each curve, at least 3.
    at : dict of str to float, optional
        Values of the conditions by name that an effect may depend on, as for `linearise`.

    Returns
    -------
    Steady
        The curves with their standard errors, as arrays, table and figure.

    Raises
    ------
    SeatrialError
        If the model is not one of a boat with a speed or a turn rate, if the range of its commands is unknown, or if
        there is no condition of a name.

    Examples
    --------
    >>> curves = st.steady("vehicle")
    >>> curves.straight.value[-1]
    >>> curves.plot().save("steady.html")
    """
    from seatrial.ident.export import chosen_conditions
    from seatrial.ident.workflows.dynamics import steady_curves

    if isinstance(points, bool) or not isinstance(points, int) or points < 3:
        raise SeatrialError(f"points {shortened(points)}: give a whole number of at least 3")
    if isinstance(means, str | Mapping) or not isinstance(means, Iterable | None):
        raise SeatrialError(f"means: give a list of numbers from 0 to 1, such as [0.0, 0.5], not {shortened(means)}")
    for mean in means or ():
        if not isinstance(mean, Real) or not 0.0 <= mean <= 1.0:
            shown = f"{mean:g}" if isinstance(mean, int | float) else shortened(mean)
            raise SeatrialError(f"means {shown}: give parts of the largest command, from 0 to 1")
    _check_conditions(at)
    with errors_of_users():
        structure, ranges, known = _estimates(model)
        conditions = chosen_conditions(structure, ranges, at)
        curves = steady_curves(structure, ranges, known, means, points, conditions)
    if not curves and (why := turn_sentence(conditions)):
        raise SeatrialError(f"model {structure.name} has no steady motion. {why}")
    if not curves:
        raise SeatrialError(
            f"model {structure.name} has no steady motion: it needs a speed u or turn rate r, and commands whose range "
            "in the fitted data is known; use a model of a boat, such as horizontal"
        )
    return Steady(tuple(curves), conditions, ranges.get("u"), ranges.get("r"))


def _check_conditions(at: object) -> None:
    """Raise SeatrialError if the conditions ``at`` are neither None nor a dict of numbers.

    A warning is issued if the heading is larger than one turn, because it is then probably in degrees.
    """
    if at is None:
        return
    if not isinstance(at, Mapping):
        raise SeatrialError(f'at: give a dict of conditions by name, such as {{"psi": 0.5}}, not {shortened(at)}')
    for name, value in at.items():
        check_number(f"at: {name}", value, "SI units and radians")
    psi = at.get("psi", 0.0)
    if 2.0 * np.pi < abs(psi) < np.inf:
        warn(f"psi = {psi:g} rad; if these are degrees, give np.radians({psi:g})")


def _estimates(
    model: PathLike | Saved | FittedResult,
) -> tuple[Model, Mapping[str, tuple[float, float]], ParameterCovariance]:
    """Return the structure of a model with its estimates, the ranges of its data by signal, and its covariance.

    A model whose effects differ between runs, or whose fit did not converge, gives a `SeatrialWarning`.
    """
    from seatrial.ident.estimation import load_model, warn_if_unconverged, warn_of_run_means
    from seatrial.ident.workflows.dynamics import covariance_of
    from seatrial.ident.workflows.output import validity

    if isinstance(model, FittedResult):
        fit = model.fitted.fit
        warn_of_run_means(fit.model)
        warn_if_unconverged(fit.converged)
        return fit.model, validity(model.fitted), covariance_of(fit)
    if isinstance(model, Saved):
        saved = model.saved_model()
    else:
        with model_path(model) as path:
            saved = load_model(path)
    warn_of_run_means(saved.model)
    warn_if_unconverged(saved.converged)
    return saved.model, saved.validity, saved.covariance()
