"""HTML page of a designed mission: expected standard errors, commands, predicted track, and baseline signals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from seatrial.daq.config import track_extent
from seatrial.daq.files import write_output
from seatrial.ident.numerics import Array
from seatrial.ident.report import formatting
from seatrial.ident.report.blocks import Canvas, Cell, Facts, Grid, Prose, Section, Table
from seatrial.ident.report.drawing import AMBER, FAINT, GREEN, MODEL, Budget, Panel, Trace, line_trace, single, stacked
from seatrial.ident.report.page import Answer, compose
from seatrial.ident.results import DesignResult, DesignTrack

COLORS = {"design": MODEL, "PRBS": AMBER, "RGS": GREEN}
DASHES = {"design": "solid", "PRBS": "dash", "RGS": "dot"}
N_BINS = 60  # of a histogram


def write_design_page(result: DesignResult, path: Path) -> None:
    """Write a design as one HTML page that opens without a network. An existing file is replaced.

    Parameters
    ----------
    result
        Result of `seatrial mission design`: the mission with its expected standard errors.
    path
        HTML file to write.

    Raises
    ------
    OSError
        If ``path`` cannot be written.
    SeatrialError
        If ``path`` is a symbolic link, a folder or a special file.
    """
    canvas = Canvas(Budget.for_traces(12))
    opening = Section("top", "", [Prose(_introduction(result), "lead"), Facts(_labelled_facts(result))])
    body = [
        _errors_section(result),
        _commands_section(canvas, result),
        _track_section(canvas, result.track),
        _baselines_section(canvas, result),
        _provenance_section(result),
    ]
    page = compose(
        "Mission design",
        Answer(result.answer),
        opening,
        [s for s in body if s.blocks],
        canvas.figures,
        version=result.seatrial,
        created=result.created,
        warnings=[warning.text for warning in result.warnings],
    )
    write_output(path, page)


def _introduction(result: DesignResult) -> str:
    """Return the introduction of the page of a designed mission.

    It has the criterion, the parameters that the criterion includes, and the kind of Fisher information; or the two
    effects to distinguish and the criterion T.
    """
    form = (
        "with process noise (prediction error)"
        if result.form == "prediction error"
        else ("without process noise (output error)")
    )
    if result.apart is not None:
        first, second = result.apart.effects
        wrong = f" {result.apart.wrong_choice}" if result.apart.wrong_choice else ""
        return (
            f"The steps of this mission distinguish {first} from {second}: they maximise the criterion T, twice the "
            "expected log-likelihood ratio of the model with the true effect against the other one, whichever is true."
            f"{wrong} Standard errors after the mission are those of a prediction-error fit to this run, combined with "
            "the information before the mission."
        )
    return (
        f"The steps of this mission maximise the {result.criterion} criterion of the Fisher information of "
        f"{', '.join(result.chosen)}, {form}. Standard errors after the mission are those of a "
        "prediction-error fit to this run, combined with the information before the mission."
    )


def _labelled_facts(result: DesignResult) -> list[tuple[str, str]]:
    """Return (label, value) of the facts at the top of the page of a designed mission.

    They are the model, the criterion of the design and of the baseline signals, the share of parameter samples in which
    the design is better than these, and the sensor rates if they are known. If two effects were to be distinguished
    (`--discriminate`), they include the criterion T for either of them, and their sizes.
    """
    found = [("model", result.model), (f"criterion {result.criterion}", formatting.plain(result.value, 4))]
    best = max((r.value for r in result.baselines), default=None)
    free = " (which ignore the limits)" if result.limited else ""
    found.append((f"best of {result.random_sequences}{free}", formatting.plain(best, 4)))
    if result.share_won is not None:
        share = formatting.percent(result.share_won, 1)
        found.append((f"better than the best PRBS and RGS{free} in", f"{share} of the samples"))
    if result.rates:
        found.append(("sensors", ", ".join(f"{name} {hz:.3g} Hz" for name, hz in result.rates.items())))
    if result.apart is not None:
        first, second = result.apart.effects
        found += [
            (f"T if {first} is true", formatting.plain(result.apart.if_first)),
            (f"T if {second} is true", formatting.plain(result.apart.if_second)),
        ]
        for row in result.apart.sizes:
            values = [
                f"{p.name} = {formatting.plain(p.value)} {formatting.typeset_unit(p.unit)}".rstrip()
                for p in row.parameters
            ]
            found.append(
                (f"{row.origin} size of {row.effect}{f', beside {row.beside}' * bool(row.beside)}", ", ".join(values))
            )
    return found


def _errors_section(result: DesignResult) -> Section:
    """Return the section with the table of standard errors before and after the mission, one row for each parameter.

    A row also has the error after the best baseline signal. A dash stands for an error without information. The section
    is empty without parameters.
    """
    columns = (
        ("parameter", ""),
        ("value", "num"),
        ("unit", ""),
        ("± before", "num"),
        ("± after", "num"),
        ("± after / value", "num"),
        (f"± after the best random sequence ({result.baseline})", "num"),
        ("meaning", ""),
    )
    lines: list[list[Cell | str]] = []
    for p in result.parameters:
        share = None if not p.value or p.after is None else abs(p.after / p.value)
        lines.append(
            [
                Cell(p.name, "symbol strong" if p.chosen else "symbol"),
                Cell(formatting.plain(p.value), "num"),
                Cell(formatting.typeset_unit(p.unit), "nowrap"),
                Cell(formatting.plain(p.before), "num"),
                Cell(formatting.plain(p.after), "num"),
                Cell("> 100 %" if share is not None and share > 1 else formatting.percent(share, 1), "num"),
                Cell(formatting.plain(p.baseline), "num"),
                Cell(p.meaning, "wide"),
            ]
        )
    return Section(
        "errors",
        "Expected standard errors",
        [Table(columns, lines)] if lines else [],
        " ".join(
            filter(
                None,
                [
                    result.other_parameters,
                    "A dash in the column “± before” means that there is no information before the mission.",
                ],
            )
        ),
    )


def _commands_section(canvas: Canvas, result: DesignResult) -> Section:
    """Return the section with the commands of the mission over time, one panel for each input; empty without inputs.

    The figure is added to ``canvas``.
    """
    panels = [
        Panel(
            f"command {row.name}, -1..1",
            [line_trace(row.t, row.value, "command", canvas.budget.points)],
            {"range": [-1.08, 1.08]},
        )
        for row in result.inputs
    ]
    if not panels:
        return Section("inputs", "", [])
    figure, height = stacked(panels, "time since the first step [s]")
    return Section("inputs", "Thruster commands", [Grid([canvas.plot(figure, height, "Commands over time")], 600)])


def _track_section(canvas: Canvas, track: DesignTrack | None) -> Section:
    """Return the section with the figure of the boat's predicted track; empty if ``track`` is None.

    The figure also has the tracks of boats with sampled parameters, and the area of operation if one was given. It is
    added to ``canvas``.
    """
    if track is None:
        return Section("track", "", [])
    traces: list[Trace] = []
    for k, sampled in enumerate(track.others):
        name = "boats with sampled parameters and process noise" if k == 0 else ""
        traces.append(
            line_trace(sampled[:, 1], sampled[:, 0], name, 400, color=FAINT)
            | {"opacity": 0.35, "showlegend": k == 0, "hoverinfo": "skip"}
        )
    traces.append(line_trace(track.y, track.x, "nominal boat", 400) | {"showlegend": True})
    traces.append(_start_marker(track.y[:1], track.x[:1]))
    current = track.current
    water = (
        f"; the sampled boats meet currents of up to {formatting.plain(current)} m/s"
        if current
        else ", without current"
    )
    words = (
        f"The boat starts at 0, 0, at rest, heading north{water}. The track covers the whole mission: {track.rest:g} s "
        f"at rest before the steps, and {track.coasting:g} s of coasting after the last step. The commands are open "
        "loop: model errors accumulate in the track, so leave a margin to the geofence of the rig file."
    )
    if (extent := track_extent(track.x, track.y, track.radius)) is not None:
        words += (
            f" With its band (at each time a circle about the nominal boat with 95 % of the sampled boats) the track "
            f"takes {extent}; one boat needs less."
        )
    if track.corner is not None and track.area is not None and track.inside is not None:
        (south, west), area = track.corner, track.area
        words += (
            f" {formatting.percent(track.inside)} of the sampled boats stay in the area (orange) if its south-west "
            f"corner is {formatting.plain(-south)} m south and {formatting.plain(-west)} m west of the start."
        )
        x, y = south + np.array([0, 1, 1, 0, 0]) * area[0], west + np.array([0, 0, 1, 1, 0]) * area[1]
        traces.append(line_trace(y, x, "area", 10, color=AMBER, dash="dash") | {"showlegend": True})
    figure = single(
        traces,
        "east [m]",
        "north [m]",
        yaxis={"scaleanchor": "x"},
        showlegend=True,
        hovermode="closest",
        legend={"orientation": "h", "y": 1.08},
    )
    return Section(
        "track",
        "Predicted track",
        [
            Grid([canvas.plot(figure, 560, "Predicted track with sampled boats")], 320, "narrow"),
            Prose(words, "caption"),
        ],
    )


def _start_marker(x: Array, y: Array) -> Trace:
    """Return the trace of a square marker at the start of the track.

    ``x`` (1,) is the horizontal coordinate, east [m], and ``y`` (1,) the vertical coordinate, north [m].
    """
    return {
        "type": "scatter",
        "mode": "markers",
        "x": x.tolist(),
        "y": y.tolist(),
        "name": "start",
        "marker": {"size": 9, "color": MODEL, "symbol": "square"},
        "showlegend": True,
    }


def _baselines_section(canvas: Canvas, result: DesignResult) -> Section:
    """Return the section that compares the design with the baseline signals (PRBS, RGS) for uncertain parameters.

    It has one histogram for the design and one for each baseline signal: the values of the criterion at samples of the
    parameters. The figure is added to ``canvas``. The section is empty if there are no samples.
    """
    samples = result.samples
    if not samples:
        return Section("baselines", "", [])
    traces = [_histogram(name, values, edges_of(samples)) for name, values in samples.items()]
    figure = single(
        traces, f"{result.criterion} criterion", "samples", showlegend=True, legend={"orientation": "h", "y": 1.12}
    )
    lead = (
        "Criterion at 1000 samples of the parameters. The samples are drawn from the standard errors of a model.toml, "
        "otherwise uniformly within the prior half-width about the nominal values. Larger is better; one unit is a "
        "factor e in the determinant. PRBS and RGS are each the best of their random sequences, with the bandwidth "
        "and amplitude that suit the nominal values; they do not keep the limits of area, speed or energy."
    )
    return Section(
        "baselines",
        "Comparison with random sequences, for uncertain parameters",
        [Grid([canvas.plot(figure, 300, "Histogram of the criterion")], 520)],
        lead,
    )


def edges_of(samples: Mapping[str, Array]) -> Array:
    """Return the common bin edges of the histograms of all signals, evenly spaced, Array (N_BINS + 1,).

    They reach from the 0.2 % to the 99.8 % quantile of the finite values of all signals, but over at least 1e-6.

    Parameters
    ----------
    samples
        Values of the criterion at samples of the parameters, by the name of the signal (``design``, ``PRBS``, ``RGS``).
        At least one must be finite.
    """
    values = np.concatenate(list(samples.values()))
    low, high = np.quantile(values[np.isfinite(values)], [0.002, 0.998])
    return np.linspace(low, max(high, low + 1e-6), N_BINS + 1)


def _histogram(name: str, values: Array, edges: Array) -> Trace:
    """Return the outline of a histogram as the trace of a filled line.

    The height is the number of values in each bin. Values beyond the bin ``edges`` count in the first or last bin.
    ``name`` is that of the signal (``design``, ``PRBS``, ``RGS``), which determines colour and dash.
    """
    count = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0].astype(float)
    outline_x, outline_y = np.repeat(edges, 2)[1:-1], np.repeat(count, 2)
    trace = line_trace(
        outline_x, outline_y, name, 1000, color=COLORS.get(name, FAINT), dash=DASHES.get(name, "dashdot")
    )
    return trace | {"fill": "tozeroy", "opacity": 0.8, "showlegend": True}


def _provenance_section(result: DesignResult) -> Section:
    """Return the section with the provenance of a designed mission: command line and number of simulations."""
    facts = [("command", result.command), ("simulations of the search over the whole mission", str(result.evaluations))]
    return Section("made", "How it was made", [Facts(facts, "made")])
