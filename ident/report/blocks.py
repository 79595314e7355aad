"""Building blocks of a report page: sections, their contents (text, tables, plots, tabs), and the collector of figures.

A *block* here is a piece of a page. Blocks contain texts and numbers that are ready to show.
``templates/blocks.html.j2`` renders each by its field ``kind``, the name of the block's type in the template.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from seatrial.ident.report.drawing import Budget, Figure


@dataclass(frozen=True)
class Prose:
    """Paragraph of text in a report page.

    Attributes
    ----------
    words
        Text of the paragraph.
    style
        CSS class; empty for an ordinary paragraph.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    words: str
    style: str = ""
    kind: str = "prose"


@dataclass(frozen=True)
class Heading:
    """Small heading inside a section of a report page, with a note in smaller type.

    Attributes
    ----------
    words
        Text of the heading.
    note
        Text in smaller type after the heading; may be empty.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    words: str
    note: str = ""
    kind: str = "heading"


@dataclass(frozen=True)
class Cell:
    """Cell of a table in a report page.

    Attributes
    ----------
    words
        Text of the cell.
    style
        CSS class; empty for an ordinary cell.
    bar
        Length of a small bar beside the text, -1 to 1, to the left if negative. None: no bar.
    """

    words: str
    style: str = ""
    bar: float | None = None


@dataclass(frozen=True)
class Table:
    """Table with a header row in a report page.

    Attributes
    ----------
    columns
        Title and CSS class of each column (``num`` for numbers).
    rows
        Cells of each row, from left to right; a plain text is a cell without a class. A row of one ``Cell`` is the
        heading of the rows below it.
    caption
        Text below the table; may be empty.
    stacked
        Whether a narrow screen shows each row as lines of titled cells. Otherwise a wide table scrolls there.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[Cell | str]]
    caption: str = ""
    stacked: bool = False
    kind: str = "table"


@dataclass(frozen=True)
class Plot:
    """Place of a figure in a report page. The figure itself is in ``Canvas.figures``.

    Attributes
    ----------
    id
        Key of the figure in ``Canvas.figures``, which is also the id of its HTML element.
    height
        Height [px].
    label
        Description of the figure for screen readers.
    title
        Heading above the figure; may be empty.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    id: str
    height: int
    label: str
    title: str = ""
    kind: str = "plot"


@dataclass(frozen=True)
class Grid:
    """Plots side by side in a report page, as many in a row as fit its width.

    Attributes
    ----------
    plots
        The plots from left to right.
    least
        Smallest width of a plot [px].
    style
        CSS class; empty for an ordinary grid.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    plots: Sequence[Plot]
    least: int = 260
    style: str = ""
    kind: str = "grid"


@dataclass(frozen=True)
class Key:
    """Legend of the lines and symbols in the figures below it in a report page.

    Attributes
    ----------
    items
        CSS class of each symbol, and its meaning.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    items: Sequence[tuple[str, str]]
    kind: str = "key"


@dataclass(frozen=True)
class Tabs:
    """Tabs of a report page, of which one is visible at a time, at first the first.

    A printed page contains the visible one, and the titles of the others.

    Attributes
    ----------
    tabs
        Title of each tab, and its contents: paragraphs, tables, plots.
    all_printed
        Whether a printed page contains all tabs.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    tabs: Sequence[tuple[str, Sequence[Any]]]
    all_printed: bool = False
    kind: str = "tabs"


@dataclass(frozen=True)
class OnScreen:
    """Part of a report page that is not printed, because it is long and its reader has the screen.

    Attributes
    ----------
    blocks
        Contents of the part: paragraphs, tables, plots.
    words
        Sentence in its place on a printed page, which says what is left out.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    blocks: Sequence[Any]
    words: str
    kind: str = "on-screen"


@dataclass(frozen=True)
class Facts:
    """List of labelled values in a report page.

    Attributes
    ----------
    items
        Label and value of each entry.
    style
        CSS class; empty for an ordinary list.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    items: Sequence[tuple[str, str]]
    style: str = ""
    kind: str = "facts"


@dataclass(frozen=True)
class Lines:
    """List of sentences in a report page, one below the other.

    Attributes
    ----------
    items
        The sentences.
    style
        CSS class; empty for an ordinary list.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    items: Sequence[str]
    style: str = ""
    kind: str = "lines"


@dataclass(frozen=True)
class Dumbbell:
    """Prediction error of one channel before and after an effect was added, drawn as two dots on a horizontal track.

    Positions are in per cent of the track's width, 0 to 100. They are proportional to the ratio of the error to the
    error before; a position beyond the track is 100.

    Attributes
    ----------
    label
        Name of the channel.
    before, after
        Errors as texts; ``after`` has the unit.
    change
        Change in per cent as a text.
    at_before, at_after
        Positions of both dots.
    low, high
        Positions of the ends of the 95 % interval, None if it is unknown.
    verdict
        ``better`` if the error fell significantly, ``worse`` if it rose significantly. Otherwise, and without a 95 %
        interval, ``same``.
    """

    label: str
    before: str
    after: str
    change: str
    at_before: float
    at_after: float
    low: float | None
    high: float | None
    verdict: str


@dataclass(frozen=True)
class Dumbbells:
    """Chart of the prediction errors of several channels before and after effects were added, on one relative scale.

    Attributes
    ----------
    items
        Pair of dots for each channel, from top to bottom.
    caption
        Text below the chart.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    items: Sequence[Dumbbell]
    caption: str
    kind: str = "dumbbells"


@dataclass(frozen=True)
class EffectCard:
    """Card of a report page for an effect that was added to the model. All fields are texts as shown.

    Attributes
    ----------
    title, name
        Title of the effect, and its name in commands.
    formula
        Formula of the effect.
    parameters
        Name, value with standard error, and meaning of each parameter.
    facts
        Label and value of further entries. A tuple is shown as a list.
    importance
        Percentage by which the effect changes the prediction error; empty if unknown.
    importance_words
        Text after ``importance``; empty if unknown.
    verdict
        ``fell``, ``rose`` or ``unchanged`` (not significant): how the effect changes the error, for the colour; empty
        if unknown.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    title: str
    name: str
    formula: str
    parameters: Sequence[tuple[str, str, str]]
    facts: Sequence[tuple[str, str | tuple[str, ...]]]
    importance: str
    importance_words: str
    verdict: str = ""
    kind: str = "effect"


@dataclass(frozen=True)
class Bar:
    """Bar of a chart for the score test of one candidate (an effect, or a nonparametric curve, that may be missing).

    Lengths are in per cent of the width of the bar's track, 0 to 100.

    Attributes
    ----------
    label, name
        Title of the candidate, and its name in commands.
    numbers
        Statistic, degrees of freedom and p values as a text.
    width
        Length of the bar: position of the statistic on a logarithmic axis.
    threshold
        Position of the critical value of the statistic.
    generic
        Whether the candidate is a nonparametric curve instead of an effect of the catalogue.
    passed
        Whether the candidate passed the score test.
    chosen
        Whether the candidate was added to the model.
    """

    label: str
    name: str
    numbers: str
    width: float
    threshold: float
    generic: bool
    passed: bool
    chosen: bool


@dataclass(frozen=True)
class Ranking:
    """Bar chart of the score tests of the candidates of a search round, on a logarithmic axis.

    Attributes
    ----------
    bars
        The bars, the best candidate first.
    ticks
        Position [per cent of the axis] and label of each tick.
    caption
        Text below the chart.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    bars: Sequence[Bar]
    ticks: Sequence[tuple[float, str]]
    caption: str
    kind: str = "ranking"


@dataclass(frozen=True)
class Verdict:
    """Finding of a check of a log or rig, as the report page shows it.

    Attributes
    ----------
    level
        ``fault``, ``warning`` or ``ok``.
    where
        Log or signal.
    check
        Name of the check.
    words
        Text of the finding.
    advice
        Remedy; may be empty.
    """

    level: str
    where: str
    check: str
    words: str
    advice: str


@dataclass(frozen=True)
class Verdicts:
    """List of findings of checks in a report page.

    Attributes
    ----------
    items
        The findings.
    kind
        Kind of this piece of the page, by which the template selects its HTML.
    """

    items: Sequence[Verdict]
    kind: str = "verdicts"


@dataclass(frozen=True)
class Section:
    """Section of a report page. An empty section, without contents, is left out of the page.

    Attributes
    ----------
    id
        Anchor of the section in the page.
    title
        Heading of the section; may be empty.
    blocks
        Contents from top to bottom.
    lead
        Introductory paragraph; may be empty.
    """

    id: str
    title: str
    blocks: Sequence[Any]
    lead: str = ""


@dataclass
class Canvas:
    """Collector of the figures of a report page while its sections are built.

    Attributes
    ----------
    budget
        Limit on the number of points of a trace (line of a figure).
    figures
        Plotly figures by the id of their ``Plot``; the method `plot` adds to them.
    """

    budget: Budget
    figures: dict[str, Figure] = field(default_factory=dict)

    def plot(self, figure: Figure, height: int, label: str, title: str = "") -> Plot:
        """Store a figure under a new id, ``figure-1`` and so on, and return its place on the page.

        Parameters
        ----------
        figure : Figure
            Plotly figure.
        height : int
            Height [px].
        label : str
            Description of the figure for screen readers.
        title : str
            Heading above the figure; may be empty.
        """
        name = f"figure-{len(self.figures) + 1}"
        self.figures[name] = figure
        return Plot(name, height, label, title)


def tabbed(tabs: Sequence[tuple[str, Sequence[Any]]], all_printed: bool = False) -> list[Any]:
    """Return a block of tabs for a report page, as a list of one. Tabs without contents are left out.

    If only one tab has contents, the list is its title as a heading, followed by its contents. If no tab has contents,
    the list is empty.

    Parameters
    ----------
    tabs
        Title of each tab, and its contents: paragraphs, tables, plots.
    all_printed
        Whether a printed page contains all tabs. False: it contains the visible one.
    """
    full = [(title, list(blocks)) for title, blocks in tabs if blocks]
    if len(full) == 1:
        return [Heading(full[0][0]), *full[0][1]]
    return [Tabs(full, all_printed)] if full else []
