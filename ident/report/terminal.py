"""Summary of a result for a terminal: about forty lines, 80 columns wide. In a pipe tables are as wide as they need."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from seatrial.daq.console import print_prose, print_table
from seatrial.daq.errors import counted
from seatrial.ident.report import formatting
from seatrial.ident.report.sections.campaigns import (
    VALUES,
    absolute_change,
    change_of,
    effect_words,
    effects_caption,
    joint_words,
)
from seatrial.ident.report.sections.comparison import (
    INSIDE,
    MARKS,
    TOO,
    difference_rows,
    interval_sentence,
    interval_words,
    kind_title,
    masses_sentence,
    ratio_words,
    signed,
    verdict_words,
)
from seatrial.ident.report.sections.parameters import interval, segment_in_words
from seatrial.ident.report.sections.predictions import by_role, error_words, horizons, unmarked_rises
from seatrial.ident.results import (
    MOST_OF_ERROR,
    NOT_TESTED,
    NOT_WEIGHED,
    ONLY_CHOSEN,
    OTHER_SURROUNDINGS,
    RUNS_AWAY,
    SIMULATION_COVERS,
    SIZE_NOT_SIGNIFICANT,
    THRUST_KNOWN,
    CampaignErrors,
    CampaignsResult,
    ComparedChannel,
    ComparedModel,
    ComparisonResult,
    DiagnosisResult,
    Difference,
    EffectParameter,
    EffectRow,
    ErrorComparison,
    Errors,
    FitResult,
    FitSummary,
    FleetResult,
    ForceScale,
    InformationResult,
    NavigationResult,
    NoiseResult,
    ParameterRow,
    ProfileCurve,
    Result,
    ThrusterResult,
    VehicleResult,
    causes_sentence,
    curve_words,
    data_name,
    judged_by_blocks,
    name_probabilities,
    standard_error_sentence,
)

# Beginnings of the notes that the terminal shows
SHOWN_NOTES = (
    SIMULATION_COVERS, MOST_OF_ERROR, RUNS_AWAY, NOT_TESTED, ONLY_CHOSEN, THRUST_KNOWN, OTHER_SURROUNDINGS,
    SIZE_NOT_SIGNIFICANT,
)  # fmt: skip
MAX_OUTAGES, MAX_SEGMENTS, MAX_NOISE_CHANNELS = 8, 24, 12  # largest numbers of rows of a table
WIDEST_INTERVALS = 72  # characters of a line of the table of the 95 % intervals
WIDEST_TEXT = 100  # characters of a line of texts in the table of what differs between models
MAX_PARAMETERS, MAX_CANDIDATES, MAX_ERROR_CHANNELS = 9, 6, 8
MOST_WITH_FIT, MOST_COMPARED = 3, 6  # largest numbers of models in a row of a table with their fit, and without it
MAX_FAILED = 8  # largest number of rows of a table of failed logs
MIN_GROWTH = 1.05  # a standard error that grows by a smaller factor does not depend on the segment


def titled_table(title: str) -> Table:
    """Return a new table for the terminal without columns and rows, with a title and the style of this module's tables.

    The title is shown as written: marks of rich in it, such as ``[bold]``, have no effect.
    """
    style = {"title_justify": "left", "title_style": "bold cyan", "header_style": "dim", "border_style": "dim"}
    return Table(title=Text(title), box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, **style)  # type: ignore[arg-type]


def tables_of(result: Result) -> list[Table]:
    """Return the tables for the terminal of a result that is not a fit: of noise, information, many logs and so on.

    A result of information has two tables: parameters and segments of the logs. The list is empty for other results
    and for a navigation without GNSS outages.
    """
    if isinstance(result, NoiseResult):
        return [noise_table(result)]
    if isinstance(result, NavigationResult):
        return [outage_table(result)] if result.outages else []
    if isinstance(result, InformationResult):
        return [parameter_table(result), segment_table(result)]
    if isinstance(result, FleetResult):
        return [*([fleet_table(result)] if result.parameters else []), *failed_tables(result)]
    if isinstance(result, CampaignsResult):
        return campaign_tables(result)
    if isinstance(result, ComparisonResult):
        if result.is_evaluation:
            return [*evaluated_tables(result), *masses_tables(result), intervals_table(result)]
        differences = [table for table in (differences_table(result),) if table is not None]
        errors = [*compared_tables(result), intervals_table(result)]
        return [models_table(result), *masses_tables(result), *differences, *errors, likelihood_table(result)]
    return []


def noise_table(result: NoiseResult) -> Table:
    """Return the table of white noise and random walk of up to 12 channels of sensors at rest.

    Channels whose noise model failed its test come first. The title has the number of channels that are left out.
    """
    shown = sorted(result.noise, key=lambda c: c.accepted)[:MAX_NOISE_CHANNELS]
    left = f" ({len(result.noise) - len(shown)} more in the report)" if len(result.noise) > len(shown) else ""
    table = titled_table(f"Noise{left}")
    table.add_column("", no_wrap=True, overflow="ellipsis")
    for title in ("white", "random walk, per √s"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("R²", justify="right", no_wrap=True)
    table.add_column("model", no_wrap=True)
    for c in shown:
        factor, unit = formatting.degrees_for(c.unit)
        white = formatting.noise_level(c.white, c.se_white, c.white_limit, factor)
        random_walk = formatting.noise_level(c.random_walk, c.se_random_walk, c.random_walk_limit, factor)
        words = (c.channel, white, random_walk, unit, formatting.percent(c.predictable, 1))
        verdict = Text("holds", "green") if c.accepted else Text("fails", "bold red")
        table.add_row(*(Text(word) for word in words), verdict)
    return table


def outage_table(result: NavigationResult) -> Table:
    """Return the table of up to eight GNSS outages, the largest predicted position error first.

    An outage is red if its error is larger than the allowed one. The title has the number
    of all outages if some are left out.
    """
    found = result.outages
    shown = sorted(found, key=lambda o: -o.at_end.radius)[:MAX_OUTAGES]
    worst = "" if len(shown) == len(found) else f" (the {len(shown)} most uncertain of {len(found)})"
    table = titled_table(f"GNSS outages{worst}")
    table.add_column("", no_wrap=True, overflow="ellipsis")
    for title in ("from [s]", "for [s]", "95 % radius [m]", "error [m]", "allowed [m]"):
        table.add_column(Text(title), justify="right", no_wrap=True)
    for o in shown:
        words = [f"{o.start:.0f}", *(formatting.plain(v) for v in (o.duration, o.at_end.radius, o.error, o.allowed))]
        style = "bold red" if o.inside is False else ""
        table.add_row(Text(o.record), *(Text(word) for word in words), style=style)
    return table


def parameter_table(result: InformationResult) -> Table:
    """Return the table of the standard errors of the parameters from all logs, with their most important segment.

    The most important segment is the part of a log that a standard error depends on most. The last column is the factor
    by which the standard error would grow without this segment. A parameter without information has the words ``no
    information`` in place of its value and standard error, no segment, and a dash as the factor.
    """
    table = titled_table("Information of these logs")
    table.add_column("", no_wrap=True)
    table.add_column("value ± s.e.", justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("depends most on", style="dim", no_wrap=True, overflow="ellipsis", max_width=32)
    table.add_column("× without it", justify="right", no_wrap=True)
    for p in result.information.parameters:
        factor, unit = formatting.degrees_for(p.unit)
        shown, segment, growth = "no information", "", "–"
        if p.se is not None:
            shown, segment = formatting.with_error(factor * p.value, factor * p.se), segment_in_words(p)
            growth = _growth_text(math.inf if p.weight is None else p.weight)
        table.add_row(Text(p.name, style="bold"), Text(shown), Text(unit), Text(segment), Text(growth))
    return table


def segment_table(result: InformationResult) -> Table:
    """Return the table of factors by which the standard errors would grow without each segment of the logs.

    The rows are the first 24 segments and the columns the first nine parameters. If there are more segments or more
    parameters, the title has the shown and the total number of them.
    """
    names, found = result.information.names, result.information.segments
    shown = names[:MAX_PARAMETERS]
    title = "Without a segment, standard errors grow by ×"
    left = [f"{MAX_SEGMENTS} of {len(found)} segments"] if len(found) > MAX_SEGMENTS else []
    left += [f"{len(shown)} of {len(names)} parameters"] if len(names) > len(shown) else []
    if left:
        title += f" ({', '.join(left)}; all in the report)"
    table = titled_table(title)
    table.padding = (0, 1, 0, 0)
    table.add_column("", style="dim", no_wrap=True, overflow="ellipsis", max_width=26)
    for name in shown:
        table.add_column(name, justify="right", no_wrap=True, min_width=4)
    for row in found[:MAX_SEGMENTS]:
        values: Sequence[float] = row.weight[: len(shown)].tolist()
        cells = [Text(_growth_text(v), style="dim" if v < MIN_GROWTH else "bold green") for v in values]
        table.add_row(Text(segment_in_words(row)), *cells)
    return table


def fleet_table(result: FleetResult) -> Table:
    """Return the table of the values of each parameter from many logs: mean, and differences between the logs.

    A scatter that the standard errors do not explain is yellow, except that of parameters such as the current, which
    differ from log to log. Noise parameters are left out, as in the table of a fit.
    """
    shown = [p for p in result.parameters if "noise" not in p.meaning]
    left = len(result.parameters) - len(shown)
    table = titled_table(f"Between the logs{f' ({left} noise parameters in result.json)' if left else ''}")
    table.padding = (0, 1, 0, 0)
    table.add_column("parameter", no_wrap=True)
    for title in ("logs", "mean ± s.e.", "sd", "s.e. of a log", "scatter", "p"):
        table.add_column(Text(title), justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for p in shown:
        factor, unit = formatting.degrees_for(p.unit)
        mean = formatting.with_error(factor * p.mean, factor * p.se_mean)
        sd, error, scatter = (formatting.plain(factor * v, 2) for v in (p.sd, p.se_own, p.scatter))
        cells = [Text(w) for w in (str(p.n), mean, sd, error)]
        style = "" if p.agree or p.per_log else "bold yellow"
        table.add_row(Text(p.name, "bold"), *cells, Text(scatter, style), Text(f"{p.p:.2g}", style), Text(unit))
    return table


def campaign_tables(result: CampaignsResult) -> list[Table]:
    """Return the tables of two campaigns: changes, effects, prediction errors, and what could not be compared.

    Combinations of parameters have a table of their own. The p value of all parameters together is below the changes.

    Parameters of noise, disturbances and sensors are left out unless they have changed, and so are parameters that are
    fixed or have a value for each log. Changed parameters come first. The unit follows the numbers that are in it.
    Tables without rows are left out.
    """
    shown = [p for p in result.changed_first if not p.nuisance or p.changed]
    left = len(result.parameters) - len(shown)
    tables = list[Table]()
    if result.combinations:
        together = sorted(result.combinations, key=lambda c: not c.changed)
        tables.append(_changes_table("Combinations of parameters", together, result.false_discovery_rate))
    if shown:
        title = f"Changes{f' ({left} of noise and disturbances in the report)' if left else ''}"
        tables.append(_changes_table(title, shown, result.false_discovery_rate, joint_words(result)))
    if result.effects:
        table = titled_table("Effects")
        for title in ("effect", "before", "after", ""):
            table.add_column(title, no_wrap=True)
        for effect in result.effects:
            table.add_row(*(Text(word) for word in effect_words(effect, result)))
        table.caption, table.caption_justify = effects_caption(result) or None, "left"
        tables.append(table)
    if result.errors:
        tables.append(_campaign_errors_table(result.errors, result.horizon))
    expected = result.expected_to_differ
    reasons = [(p.name, p.reason) for p in result.not_compared if p not in expected]
    failed = [(row.log, row.reason) for row in result.failed]
    unpredicted = [(row.log, row.reason) for row in result.unpredicted]
    found = (("Not compared", "parameter", reasons), ("Failed", "log", failed), ("Not predicted", "log", unpredicted))
    tables += [_reasons_table(title, what, rows) for title, what, rows in found if rows]
    return tables


def _changes_table(title: str, shown: Sequence[Difference], rate: float, caption: str = "") -> Table:
    """Return the table of the differences of parameters or combinations, with a caption below it.

    ``rate`` is the false discovery rate, with which the q values were compared.
    """
    table = titled_table(title)
    table.caption, table.caption_justify = caption or None, "left"
    table.padding = (0, 1, 0, 0)
    table.add_column("", no_wrap=True)
    for column in ("before ± s.e.", "after ± s.e.", "change"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for column in ("change (95 %)", "q"):
        table.add_column(column, justify="right", no_wrap=True)
    for p in shown:
        factor, unit = formatting.degrees_for(p.unit)
        means = (formatting.with_error(factor * m.mean, factor * m.se) for m in (p.before, p.after))
        style = "bold green" if p.changed else ""
        words = [Text(w) for w in means]
        words += [Text(absolute_change(p), style), Text(unit)]
        words += [Text(change_of(p), style), Text(formatting.probability(p.q, rate), style)]
        table.add_row(Text(p.name, style or "bold"), *words)
    return table


def _campaign_errors_table(errors: Sequence[CampaignErrors], horizon: float) -> Table:
    """Return the table of the RMS prediction errors on the logs of each campaign, with the values of each model."""
    channels = list(dict.fromkeys(name for e in errors for name in e.channels))[:MAX_ERROR_CHANNELS]
    table = titled_table(f"Prediction error (rms) {horizon:g} s ahead")
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, style="dim")
    for e in errors:
        table.add_column(f"logs {e.logs}, {VALUES[e.values]}", justify="right")
    for channel in channels:
        factor, unit = formatting.degrees_for(next(e.channels[channel].unit for e in errors if channel in e.channels))
        cells = [e.channels.get(channel) for e in errors]
        numbers = [error_words(None if c is None or c.after is None else factor * c.after) for c in cells]
        table.add_row(Text(channel, "bold"), Text(unit), *(Text(n) for n in numbers))
    return table


def failed_tables(result: FleetResult) -> list[Table]:
    """Return the tables of logs without a fit, and of logs whose fit did not converge, with the reasons.

    A table without rows is left out.
    """
    found = (("Failed", result.failed), ("Not converged", result.unconverged))
    return [_reasons_table(title, "log", [(row.log, row.reason) for row in rows]) for title, rows in found if rows]


def _reasons_table(title: str, what: str, rows: Sequence[tuple[str, str]]) -> Table:
    """Return a table of logs or parameters (``what``) with a reason for each, at most eight rows."""
    more = f" (first {MAX_FAILED} of {len(rows)}; all in result.json)" if len(rows) > MAX_FAILED else ""
    table = titled_table(f"{title}{more}")
    table.add_column(what, style="bold", overflow="ellipsis", max_width=36, no_wrap=True)
    table.add_column("reason")
    for name, reason in rows[:MAX_FAILED]:
        table.add_row(Text(name), Text(reason))
    return table


def models_table(result: ComparisonResult) -> Table:
    """Return the table of the compared models: label, error against the first model, counts of verdicts, and name.

    The error is the ratio over all channels and the first horizon. A mark shows whether the model is better (▼) or
    worse (▲) than the first one. The counts are the numbers of channels and kinds of prediction in which it is better,
    worse, not distinguishable, and without an interval.
    """
    title = f"Models, free parameters (+ per log), and error {result.horizons[0]:g} s ahead over all channels"
    table = titled_table(title)
    table.padding = (0, 1, 0, 0)
    table.add_column("", no_wrap=True, style="bold")
    for title in ("free", f"error/({result.models[0].label})", "95 %", "▼/▲/same/no interval"):
        table.add_column(Text(title), justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for m in result.models:
        ratio = m.ahead(result.horizons[0])
        first = m is result.models[0]
        words = "1" if first else ratio_words(ratio)
        error = Text(words) if ratio is None else Text(MARKS[ratio.verdict][0] + words, STYLES[ratio.verdict])
        counts = "–" if first else "/".join(str(n) for n in result.counts(m.label).values())
        cells = (Text(w) for w in (interval_words(ratio), counts, m.name))
        free = f"{m.n_free} + {len(m.per_log)}" if m.per_log else str(m.n_free)  # the second number is for each log
        table.add_row(Text(f"({m.label})"), Text(free), error, *cells)
    return table


def masses_tables(result: ComparisonResult) -> list[Table]:
    """Return the table of the masses of each model with their standard errors; empty if no model has any."""
    table = titled_table("Masses")
    table.show_header = False
    table.padding = (0, 1, 0, 0)
    table.add_column("", no_wrap=True, style="bold")
    table.add_column("", overflow="fold")
    for m in result.models:
        if words := masses_sentence(m, result.weighed_mass):
            table.add_row(Text("" if result.is_evaluation else f"({m.label})"), Text(words))
    return [table] if table.row_count else []


def differences_table(result: ComparisonResult) -> Table | None:
    """Return the table of the differences of each model from the first one; None without a known difference.

    A row has one kind of difference. Its cell lists the entries of this model that the first model lacks, and then the
    entries of the first model that this model lacks.
    """
    reference = result.models[0].label
    table = titled_table("What differs")
    table.padding = (0, 1, 0, 0)
    table.show_header = False
    table.add_column("", no_wrap=True, style="bold")
    table.add_column("", no_wrap=True)
    table.add_column("", overflow="fold", max_width=WIDEST_TEXT)  # piped output has no width of its own
    for m in result.models[1:]:
        for n, (title, here, there) in enumerate(difference_rows(m)):
            sides = [f"({label}) {texts}" for label, texts in ((m.label, here), (reference, there)) if texts]
            table.add_row(Text("" if n else f"({m.label})"), Text(title), Text("; ".join(sides)))
    return table if table.row_count else None


def compared_tables(result: ComparisonResult) -> list[Table]:
    """Return a table of the RMS errors of all models for each kind of prediction, with a row for each channel.

    With up to three models, a cell also has the fit. More than six models are divided into several tables. The last row
    has the share of the errors of all channels inside the 95 % intervals of each model.
    """
    labels = [m.label for m in result.models]
    with_fit, tables = len(labels) <= MOST_WITH_FIT, []
    for kind in result.kinds:
        rows = [row for row in result.channels if (row.kind, row.seconds) == kind]
        for begin in range(0, len(labels), MOST_COMPARED):
            shown = labels[begin : begin + MOST_COMPARED]
            table = titled_table(f"RMS error{' and fit' * with_fit}: {_lower(kind_title(*kind))}")
            table.padding = (0, 1, 0, 0)
            table.add_column("", no_wrap=True)
            table.add_column("", no_wrap=True)
            for label in shown:
                table.add_column(Text(f"({label})"), justify="right", no_wrap=True)
            table.add_column("best or as good", no_wrap=True)
            for row in rows:
                factor, unit = formatting.degrees_for(row.unit)
                cells = [_compared_cell(row, label, factor, with_fit) for label in shown]
                table.add_row(Text(row.channel), Text(unit), *cells, Text(_best_words(row)))
            shares = [result.inside_95(*kind, label) for label in shown]
            if any(share is not None for share in shares):
                inside = [Text(formatting.percent(share), "dim") for share in shares]
                table.add_row(Text("in 95 %", "dim"), Text(""), *inside, Text(""))
            tables.append(table)
    return tables


def evaluated_tables(result: ComparisonResult) -> list[Table]:
    """Return a table of the errors of one model alone for each kind of prediction, with a row for each channel.

    A row has the RMS error, the fit, and the share of the errors inside the 95 % intervals, with the verdict on them if
    they are too narrow or too wide.
    """
    tables, label = [], result.models[0].label
    for kind in result.kinds:
        table = titled_table(kind_title(*kind))
        table.padding = (0, 1, 0, 0)
        table.add_column("", no_wrap=True)
        table.add_column("", no_wrap=True)
        for title in ("RMS error", "fit", INSIDE):
            table.add_column(Text(title), justify="right", no_wrap=True)
        table.add_column("", no_wrap=True)
        for row in result.channels:
            if (row.kind, row.seconds) != kind:
                continue
            factor, unit = formatting.degrees_for(row.unit)
            for e in row.errors:
                error = error_words(None if e.rms is None else factor * e.rms)
                cells = (row.channel, unit, error, formatting.percent(e.fit), formatting.percent(e.inside_95))
                table.add_row(*map(Text, cells), Text(TOO.get(e.intervals or "right", ""), "bold red"))
        if (share := result.inside_95(*kind, label)) is not None:
            table.add_row(Text("all", "dim"), "", "", "", Text(formatting.percent(share), "dim"), "")
        tables.append(table)
    return tables


def intervals_table(result: ComparisonResult) -> Table:
    """Return a table that describes the 95 % intervals of each model in one sentence."""
    table = titled_table("95 % intervals")
    table.show_header = False
    table.padding = (0, 1, 0, 0)
    table.add_column("", no_wrap=True, style="bold")
    table.add_column("", overflow="fold", max_width=WIDEST_INTERVALS)
    for m in result.models:
        name = "" if result.is_evaluation else f"({m.label})"
        table.add_row(Text(name), Text(interval_sentence(result, m)))
    return table


def _best_words(row: ComparedChannel) -> str:
    """Return the labels of the best models of a channel as text; a dash if there are none.

    It is ``all`` if there are more than two models and all are equally good. If a ratio to the best model has no
    interval, the text ends with the number of blocks of time: ``a; no interval: 2 blocks``. If none has one, it names
    no model: ``undecided; no interval: 2 blocks``. Models without a verdict whose errors are larger than that of a
    worse one are unclear: ``b; unclear: a``.
    """
    if row.undecided:
        return f"undecided; {verdict_words(row.unproven[0])}"
    words = "all" if row.all_equal else " ".join(row.not_worse) or "–"
    if row.unclear:
        words += f"; unclear: {' '.join(row.unclear)}"
    return f"{words}; {verdict_words(row.unproven[0])}" if row.unproven else words


STYLES = {"better": "bold green", "worse": "bold red", "indistinguishable": "", "no-interval": ""}


def _lower(title: str) -> str:
    """Return a title with a small first letter: ``Simulation`` becomes ``simulation``."""
    return title[0].lower() + title[1:]


def _compared_cell(row: ComparedChannel, label: str, factor: float, with_fit: bool) -> Text:
    """Return the cell of one model: the RMS error, with a mark if it is better or worse than the first model.

    ``factor`` is that to the shown unit. A model that does not predict the channel has a dash.
    """
    e = next((e for e in row.errors if e.model == label), None)
    if e is None:
        return Text("–")
    mark, style = "", ""
    if e.against_reference is not None:
        mark, style = MARKS[e.against_reference.verdict][0], STYLES[e.against_reference.verdict]
    words = error_words(None if e.rms is None else factor * e.rms)
    fit = f" {formatting.percent(e.fit):>6}" if with_fit else ""
    return Text(mark + words, style) + Text(fit, "dim")


def likelihood_table(result: ComparisonResult) -> Table:
    """Return the table of the log score and of the information criteria of each model, in sentences."""
    table = titled_table(f"Likelihood against ({result.models[0].label}), one step ahead")
    table.show_header = False
    table.padding = (0, 1, 0, 0)
    table.add_column("", no_wrap=True, style="bold")
    table.add_column("", overflow="fold")
    for m in result.models[1:]:
        table.add_row(Text(f"({m.label})"), Text(" ".join(_likelihood_sentences(m))))
    return table


def _likelihood_sentences(m: ComparedModel) -> list[str]:
    """Return the sentences on the likelihood of a model against the first one: log score, and criteria or a reason."""
    if m.score is None:
        return ["The models do not predict the same samples, so their likelihoods are not compared."]
    low, high = m.score.low, m.score.high
    verdict = verdict_words(m.score)
    words = f"({verdict})" if low is None or high is None else f"(95 %: {signed(low)} to {signed(high)}): {verdict}"
    begin = "On unused logs the" if m.score.held_out else "The"
    found = [f"{begin} log score is {signed(m.score.gain)} {words}."]
    if m.criteria is None:
        # The score of logs that no model was fitted to needs no correction, so the criteria are not missed.
        return found if m.score.held_out else [*found, f"No AIC, BIC or likelihood ratio: {m.no_criteria}."]
    c = m.criteria
    found.append(f"ΔAIC {signed(c.aic)}, ΔBIC {signed(c.bic)}.")
    if c.p is not None:
        of, p = counted(c.parameters, "parameter"), formatting.p_equals(c.p)
        found.append(f"Likelihood ratio {formatting.plain(2.0 * c.gain)} for {of}, p {p}.")
    return found


def _growth_text(factor: float) -> str:
    """Return the factor by which a standard error grows without a segment of the logs, as text of two digits.

    ``all``: only this segment informs the parameter (infinite factor). A dash: no segment informs it (NaN). A dot: the
    factor is below 1.05, so that the standard error does not depend on the segment.
    """
    if math.isnan(factor):
        return "–"
    return "all" if math.isinf(factor) else "·" if factor < MIN_GROWTH else formatting.plain(factor, 2)


def print_result(result: Result, console: Console) -> None:
    """Print the warnings, the answer, the caveat of a diagnosis and the tables of a result to the console.

    The warnings of a comparison follow its answer: they are about single models of it.
    The notes of a run over many logs follow its tables, and so do the names of the common errors in a vehicle model,
    and notes on what no table shows: no weighed mass, simulations of short records or that run
    away, and times of most of the errors.
    The prediction errors of a diagnosis, its last table, are followed by the sentences on how they are computed, and by
    the reason why no experiment is recommended, if there is none. The report has a recommended experiment.

    The tables of a fit are its parameters, profile likelihoods and prediction errors; a diagnosis adds the candidates.
    A table of a fit without rows is left out. The answer of a fit that did not converge is printed as a warning.

    Parameters
    ----------
    result
        Result of a command.
    console
        Console of rich to print to.
    """
    console.print()
    failed = isinstance(result, FitResult) and not result.converged
    opening = [Text(f"⚠ {warning.text}", style="yellow") for warning in result.warnings]
    errors = standard_error_sentence(result.answer, getattr(result, "caveat", None))
    text = " ".join(filter(None, (result.answer, errors)))
    answer = Text(f"⚠ {text}", "bold yellow") if failed else Text(text, "bold")
    opening.insert(0 if isinstance(result, ComparisonResult) else len(opening), answer)
    for paragraph in opening:
        print_prose(console, paragraph)
    if isinstance(result, DiagnosisResult) and (names := name_probabilities(result.effects)):
        print_prose(console, Text(names))
    if isinstance(result, DiagnosisResult) and result.caveat:
        print_prose(console, Text(result.caveat, style="yellow"))
    if isinstance(result, DiagnosisResult) and (causes := causes_sentence(result.effects)):
        print_prose(console, Text(causes))
    table: Table | None = None
    for table in _all_tables(result):
        if table is not None:
            console.print()
            print_table(console, table, indent=1)
    if isinstance(result, DiagnosisResult) and table is not None:
        if words := _larger_errors(result):
            print_prose(console, Text(words))
        print_prose(console, Text(result.errors_caveat, style="dim"))
    if isinstance(result, DiagnosisResult) and result.no_experiment:
        print_prose(console, Text(result.next_experiment, style="dim"))
    if isinstance(result, VehicleResult) and result.common_errors is not None:
        text = (
            f"Small errors that every craft has are estimated too: {', '.join(result.common_errors.names)} "
            "(--no-score-tests, in Python score_tests=False, leaves them out)."
        )
        print_prose(console, Text(text, style="dim"))
    for note in result.notes:
        if note == NOT_WEIGHED or note.startswith(SHOWN_NOTES):
            print_prose(console, Text(note, style="dim"))
    for note in result.notes if isinstance(result, FleetResult | CampaignsResult) else ():
        console.print()
        print_prose(console, Text(note, style="dim"))
    console.print()


def _all_tables(result: Result) -> Sequence[Table | None]:
    """Return the tables for the terminal of any result, in the order of printing.

    A table of a fit that would have no rows is None.
    """
    if not isinstance(result, FitResult):
        return tables_of(result)
    diagnosis = result if isinstance(result, DiagnosisResult) else None
    return [
        _parameters_table(
            result.fit,
            diagnosis.effects if diagnosis else (),
            result.effect_parameters if isinstance(result, VehicleResult) else (),
            diagnosis.environment_parameters if diagnosis else (),
        ),
        _profiles_table(result.profiles if isinstance(result, VehicleResult | ThrusterResult) else ()),
        _candidates_table(diagnosis) if diagnosis else None,
        _errors_table(result.errors, result.horizon_seconds, judged_by_blocks(result)),
    ]


def _parameters_table(
    fit: FitSummary, added: Sequence[EffectRow], requested: Sequence[str], environment: Sequence[str]
) -> Table | None:
    """Return the table of up to nine estimated parameters: those of the added effects first, then those of the model.

    Noise parameters (with the word noise in their meaning) that are not at a bound, and fixed parameters of the model,
    are left out. Per-record parameters of the model come last. The result is None if no parameter is left. A flag that
    is a sentence stands below the table. ``added`` has the effects that a diagnosis added; empty for other fits.
    ``requested`` has the names of the parameters of effects that the user added, which come first too, even if they are
    more than nine. ``environment`` has those of effects of the environment in a diagnosed model, which follow.
    """
    effects = [row for effect in added for row in effect.parameters]
    effect_names = {row.name for row in effects}
    fitted = [
        row
        for row in fit.parameters
        if row.free
        and row.name not in effect_names
        and ("noise" not in row.meaning or row.name in requested or row.origin_in_table != row.origin)
    ]
    # Parameters of requested effects first, then those of the environment, and per-record parameters last
    fitted.sort(key=lambda row: (row.name not in requested, row.name not in environment, row.record is not None))
    found: list[EffectParameter | ParameterRow] = [*effects, *fitted]
    if not found:
        return None
    shown = found[: max(MAX_PARAMETERS, len({*requested} & {row.name for row in found}))]
    more = f" ({len(found) - len(shown)} more in the report)" if len(found) > len(shown) else ""
    table = titled_table(f"Parameters{more}")
    table.add_column("", no_wrap=True)
    table.add_column(error_title(fit.scale), justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("", style="dim", overflow="fold")
    sentences = []
    for row in shown:
        factor, unit = formatting.degrees_for(row.unit)
        value, se = formatting.scaled(factor, row.value, row.se)
        name = Text(row.name, style="bold green" if row.name in effect_names or row.name in requested else "bold")
        flag, record = (row.flag, row.record) if isinstance(row, ParameterRow) else (None, None)
        words = row.meaning + (f", {record}" if record else "")
        if isinstance(row, EffectParameter) and row.at_bound:
            words = f"⚠ at its limit: {words}"
        if flag and len(flag) > formatting.LONGEST_FLAG:
            sentences.append(f"⚠ {row.name}: {flag}")
            words = f"⚠ {words}"
        elif flag:
            words = f"⚠ {flag}"
        table.add_row(name, Text(formatting.with_error(value, se)), Text(unit), Text(words))
    if sentences:
        table.caption, table.caption_justify = Text("\n".join(sentences)), "left"
    return table


def error_title(scale: ForceScale) -> str:
    """Return the title of the column of values and standard errors in the table of parameters.

    It is ``value ± s.e.``, with ``(statistical only)`` if the standard errors exclude the uncertainty of the thrust.
    """
    return "value ± s.e. (statistical only)" if scale.statistical_only else "value ± s.e."


def _profiles_table(found: Sequence[ProfileCurve]) -> Table | None:
    """Return the table that compares the 95 % intervals of the profile likelihood with those of the standard errors.

    The result is None if there are no profiles.
    """
    if not found:
        return None
    table = titled_table("Profile likelihood")
    table.add_column("", no_wrap=True, style="bold")
    for title in ("value", "95 % by profile", "95 % by s.e."):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("", style="dim", overflow="fold")
    for row in found:
        factor, unit = formatting.degrees_for(row.unit)
        spans = [
            interval(*formatting.scaled(factor, *ends)) for ends in ((row.low, row.high), (row.wald_low, row.wald_high))
        ]
        words = [row.name, formatting.plain(factor * row.value), *spans, unit, "; ".join(row.notes)]
        table.add_row(*(Text(word) for word in words))
    return table


def _candidates_table(result: DiagnosisResult) -> Table | None:
    """Return the table of the six best candidates of the first search round that tested any, with their score tests.

    A candidate is an effect or nonparametric curve that may be missing. A mark shows whether it was added to the model
    in any round, was added and removed again, or passed the score test. Below the table stands what the name of the
    first curve of each force means. The result is None if no round tested candidates.
    """
    found = [row for row in result.rounds if row.candidates]
    if not found:
        return None
    every, removed = found[0].candidates, {row.name for row in result.removed_effects}
    chosen = {row.chosen for row in found if row.chosen} - removed
    # An added curve has a longer name than its candidate: "unknown N(psi)" for "N(psi)".
    chosen, removed = (names | {name.removeprefix("unknown ") for name in names} for names in (chosen, removed))
    shown = every[:MAX_CANDIDATES]
    passed = f"{found[0].passed} of {found[0].tested} candidates passed"
    title = f"First round: {passed}; the {len(shown)} best by score/df"
    table = titled_table(title)
    curves: dict[str, str] = {}  # the first curve of each force or sensor, whose name explains the others
    for row in shown:
        if words := curve_words(row.name):
            curves.setdefault(row.name.partition("(")[0], f"{row.name}: {words}")
    legend = ["✓ added", *["− added and removed again"] * bool(removed), "· passed", *curves.values()]
    table.caption, table.caption_justify = Text("   ".join(legend)), "left"
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, overflow="ellipsis", max_width=38)
    for title in ("score", "df", "score/df", "block-robust p"):
        table.add_column(title, justify="right", no_wrap=True)
    for row in shown:
        won = row.name in chosen
        style = "bold green" if won else "" if row.passed else "dim"
        each = formatting.plain(row.lm / max(row.df, 1))  # by which the candidates are sorted
        numbers = (formatting.plain(row.lm), formatting.count(row.df), each, formatting.probability(row.p_block))
        mark = "✓" if won else "−" if row.name in removed else "·" if row.passed else " "
        label = row.name if row.generic else row.title or row.name
        table.add_row(*(Text(part) for part in (mark, label, *numbers)), style=style)
    return table


def _errors_table(errors: Errors, seconds: float, in_blocks: bool) -> Table | None:
    """Return the table of the RMS prediction errors of up to eight channels; None if there are no channels.

    It has a column for each kind of prediction: over the horizon of ``seconds`` [s], one step ahead, simulation. The
    errors are those on the validation data if the result has any, otherwise those on the estimation data.
    ``in_blocks``: whether blocks of time take the place of validation logs.
    """
    role, data = by_role(errors.validation, errors.estimation)[0]
    kinds = [(title, table) for title, table in horizons(data, seconds) if table]
    every = list(dict.fromkeys(name for _, table in kinds for name in table))
    channels = every[:MAX_ERROR_CHANNELS]
    if not channels:
        return None
    more = f" ({len(every) - len(channels)} more in the report)" if len(every) > len(channels) else ""
    rows = [table[c] for _, table in kinds for c in channels if c in table]
    compared = any(row.before is not None and row.before != row.after for row in rows)
    quantity = "Error before → after" if compared else "Prediction error (rms)"
    table = titled_table(f"{quantity}, {data_name(role, in_blocks)}{more}")
    table.add_column("", no_wrap=True)
    table.add_column("", no_wrap=True, style="dim")
    for title, _ in kinds:
        table.add_column(title.lower(), justify="right", no_wrap=True)
    for channel in channels:
        found = [rows.get(channel) for _, rows in kinds]
        unit = next(formatting.degrees_for(row.unit)[1] for row in found if row is not None)
        table.add_row(Text(channel, style="bold"), Text(unit), *(_error_text(row) for row in found))
    return table


def _larger_errors(result: DiagnosisResult) -> str:
    """Return the sentence on errors of the last table that are larger after than before, but not marked; often ""."""
    _, data = by_role(result.errors.validation, result.errors.estimation)[0]
    return unmarked_rises(horizons(data, result.horizon_seconds))


def _error_text(row: ErrorComparison | None) -> Text:
    """Return the RMS prediction errors of a channel before and after effects were added: ``0.31 → 0.12``.

    A significant fall is green, and a significant rise is red. If one of both is None, or both are the same because no
    effect was added, only the error after is returned (``diverged`` for None). The text is empty if ``row`` is None.
    Angles are in degrees.
    """
    factor = 1.0 if row is None else formatting.degrees_for(row.unit)[0]
    before, after = (None, None) if row is None else formatting.scaled(factor, row.before, row.after)
    if before is None or after is None or before == after:
        return Text("" if row is None else error_words(after))
    color = {"fell": "green", "rose": "red"}.get(row.verdict or "" if row else "", "")
    return Text.assemble(f"{formatting.plain(before)} → ", (formatting.plain(after), color))
