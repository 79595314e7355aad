"""Self-contained HTML page of a result (report.html): styles, scripts and figures are embedded."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from seatrial.daq.files import write_output
from seatrial.ident.report import formatting, sections
from seatrial.ident.report.blocks import Canvas, EffectCard, Grid, Prose, Section
from seatrial.ident.report.drawing import DARK, TEMPLATE, Budget, Figure, compact
from seatrial.ident.report.record_tabs import log_of_block
from seatrial.ident.report.sections.runs import INPUT_POINTS
from seatrial.ident.results import ComparisonResult, DiagnosisResult, Result, standard_error_sentence

PLOTLY = "plotly-cartesian.min.js"  # the bundle with lines, heat maps and bars (docs/decisions/0036-vendored-plotly.md)
LONG_HEADLINE = 110  # characters, above which a headline has smaller letters
OPTION = re.compile(r"(?<![\w-])(--[a-z][a-z0-9]*(?:-[a-z0-9]+)*)")  # of the command line; a group for `re.split`
LARGEST_PAGE = 3_000_000  # bytes: mail and version control take it, and a phone opens it at once
TOTAL_POINTS = (200_000, 120_000, 70_000)  # points of all curves of a page, from the first that is small enough
KINDS = {
    "thruster": "Thruster identification",
    "thrust_curve": "Thruster identification",
    "vehicle": "Vehicle identification",
    "diagnosis": "Diagnosis",
    "noise": "Sensor noise",
    "navigation": "Navigation",
    "information": "Information in logs",
    "campaigns": "Changes between campaigns",
    "comparison": "Comparison of models",
}


class Answer(NamedTuple):
    """Answer of a result, as the headline of its page.

    Attributes
    ----------
    text
        The answer. Text between backquotes is shown as code.
    sizes
        Size of each effect in words by its title. Sizes that stand in brackets after the title in a long headline are
        shown as a list below it.
    """

    text: str
    sizes: Mapping[str, str] = MappingProxyType({})

    def parts(self) -> tuple[str, str, list[tuple[str, str]]]:
        """Return the headline, the sentences that follow it, and the list of titles and sizes, which may be empty."""
        headline, more = _first_sentence(self.text)
        found = []
        for title, size in self.sizes.items() if len(headline) > LONG_HEADLINE else ():
            if f"{title} ({size})" in headline:
                headline = headline.replace(f"{title} ({size})", title)
                found.append((title[:1].upper() + title[1:], size))
        return headline, more, found


def write_report(result: Result, path: Path) -> None:
    """Write a result as one HTML page that opens without a network. An existing file is replaced.

    Sections without data are left out.

    Parameters
    ----------
    result
        Result of a command.
    path
        HTML file to write.

    Raises
    ------
    OSError
        If ``path`` cannot be written.
    SeatrialError
        If ``path`` is a symbolic link, a folder or a special file.
    TypeError
        If there is no page for this type of result (designs and studies have their own pages).
    """
    write_output(path, render(result))


def render(result: Result) -> str:
    """Return the HTML text of the page of a result, with all figures embedded.

    The figures have fewer points if the page would otherwise be larger than 3 MB. A page with dozens of records is
    larger all the same, because a curve keeps at least 70 points.

    Raises
    ------
    TypeError
        If there is no page for this type of result (designs and studies have their own pages).
    """
    page = ""
    for total in TOTAL_POINTS:
        page = _page(result, Budget.for_traces(_count_traces(result), total))
        if len(page.encode()) <= LARGEST_PAGE:
            break
    return page


def _page(result: Result, budget: Budget) -> str:
    """Return the HTML text of the page of a result, whose curves have at most the points of the ``budget``."""
    canvas = Canvas(budget)
    opening, body = sections.opening(result), sections.body(canvas, result)
    evaluation = isinstance(result, ComparisonResult) and result.is_evaluation
    effects = result.effects if isinstance(result, DiagnosisResult) else ()
    return compose(
        "Evaluation of a model" if evaluation else KINDS[str(type(result).__struct_config__.tag)],
        Answer(result.answer, {e.title: e.in_words for e in effects if e.in_words}),
        opening,
        body,
        canvas.figures,
        version=result.seatrial,
        created=result.created,
        # Those of a comparison are in its opening, after the headline.
        warnings=[] if isinstance(result, ComparisonResult) else sections.warning_texts(result),
    )


def figure_page(title: str, figure: Figure) -> str:
    """Return the HTML text of a page with one figure, which needs no network.

    Parameters
    ----------
    title : str
        Headline of the page.
    figure : dict
        Figure in the JSON of Plotly, with its height [px] in the layout; without one it is 500 px.
    """
    canvas = Canvas(Budget())
    plot = canvas.plot(figure, int(figure["layout"].get("height", 500)), title)
    body = [Section("figure", "", [Grid([plot])])]
    opening = Section("answer", "", [])
    return compose("Figure", Answer(title), opening, body, canvas.figures, version=version("seatrial"))


def compose(
    kind: str,
    answer: Answer,
    opening: Section,
    body: Sequence[Section],
    figures: Mapping[str, Figure],
    *,
    version: str,
    created: str = "",
    warnings: Sequence[str] = (),
) -> str:
    """Return the HTML text of a page from its parts, with styles, scripts and figures embedded.

    Parameters
    ----------
    kind : str
        Kind of the result in words, shown above the headline and in the title.
    answer : Answer
        Answer of the result, whose first sentence is the headline of the page.
    opening : Section
        Section whose blocks follow the headline. Its title and lead are not shown, and it is not in the contents.
    body : sequence of Section
        Sections of the page; each with a title has an entry in the contents.
    figures : mapping
        Plotly figures by the id of their ``Plot``. If there are none, the page lacks the script of Plotly.
    version, created : str
        Version of seatrial and time (ISO 8601; may be empty), for the footer.
    warnings : sequence of str
        Sentences shown below the headline and the rest of the answer.
    """
    headline, more, sizes = answer.parts()
    headline = formatting.tied(headline)
    scripts = [_template_file(PLOTLY), _template_file("report.js")] if figures else [_template_file("report.js")]
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            kind=kind,
            answer=formatting.tied(answer.text),
            parts=_details(headline or "This result has no answer."),
            is_long=len(headline) > LONG_HEADLINE,
            more=formatting.tied(more),
            sizes=[(formatting.tied(title), formatting.tied(size)) for title, size in sizes],
            errors=standard_error_sentence(answer.text, *_texts(opening)),
            warnings=warnings,
            created=formatting.moment(created),
            version=version,
            opening=opening,
            sections=body,
            style=Markup(_template_file("style.css")),
            scripts=[Markup(script) for script in scripts],
            policy=_content_security_policy(scripts),
            figures=Markup(
                _script_safe_json(
                    {"template": TEMPLATE, "dark": DARK, "figures": {k: compact(f) for k, f in figures.items()}}
                )
            ),
        )
    )


@cache
def _environment() -> Environment:
    """Return the Jinja environment of the page templates. It is created once.

    An undefined variable in a template raises jinja2.UndefinedError, and text is escaped for HTML.
    """
    made = Environment(
        loader=PackageLoader("seatrial.ident.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["unbroken"] = _with_unbroken_options
    return made


def _with_unbroken_options(text: str) -> Markup:
    """Return a text for HTML in which no line is broken inside an option of the command line, such as ``--effect``.

    A browser breaks lines after a hyphen. A no-break hyphen in its place would be copied with the command.
    """
    parts = OPTION.split(text)  # every second one is an option
    found = (
        escape(x) if k % 2 == 0 else Markup('<span class="option">{}</span>').format(x) for k, x in enumerate(parts)
    )
    return Markup("").join(found)


def _count_traces(result: Result) -> int:
    """Return the approximate number of traces (lines) in the figures of the page of a result.

    It is the sum over the tables of the result: number of rows times the number of traces that a row needs. The more
    traces the page has, the fewer points each of them gets.
    """
    weights = {"residuals": 2, "residual_forces": 4, "noise": 2, "navigation": 40}
    count = sum(weight * len(getattr(result, key, ())) for key, weight in weights.items())
    for key, weight in {"traces": 8, "track": 3, "inputs": INPUT_POINTS}.items():
        # The blocks of a log are drawn as one line, and its inputs once.
        found = set()
        for row in getattr(result, key, ()):
            log = log_of_block(row.record, (x.name for x in result.logs))
            name = getattr(row, "channel", getattr(row, "name", ""))
            found.add((log or row.record, log is not None and key != "inputs", name))
        count += weight * len(found)
    if isinstance(result, ComparisonResult):
        count = sum(1 + 2 * len(row.predictions) for row in result.traces)
    return count


def _first_sentence(text: str) -> tuple[str, str]:
    """Return the first sentence of a text, and the rest; the rest is empty if there is one sentence only."""
    first, *rest = re.split(r"(?<=[.!?])[ \n](?=[A-Z`])", text, maxsplit=1)
    return first, "".join(rest)


def _texts(opening: Section) -> list[str]:
    """Return the caveat of a diagnosis and the estimates of its effects, from the opening of a page."""
    cards = [block for block in opening.blocks if isinstance(block, EffectCard)]
    caveats = [block.words for block in opening.blocks if isinstance(block, Prose) and block.style == "callout"]
    return [*caveats, *(text for card in cards for _, text, _ in card.parameters)]


def _details(headline: str) -> list[tuple[str, bool]]:
    """Return the parts of a headline, and whether each of them is a detail: a text in parentheses with a number.

    A page with a long headline shows details in smaller letters. Parentheses may contain others. A headline of at most
    `LONG_HEADLINE` characters has no details, and one whose parentheses do not match neither.
    """
    if len(headline) <= LONG_HEADLINE:
        return [(headline, False)]
    parts, depth, start = list[tuple[str, bool]](), 0, 0
    for k, sign in enumerate(headline):
        if sign == "(" and depth == 0:
            parts.append((headline[start:k], False))
            start = k
        depth += (sign == "(") - (sign == ")")
        if sign == ")" and depth == 0:
            text = headline[start : k + 1]
            parts.append((text, any(c.isdigit() for c in text)))
            start = k + 1
    return [*parts, (headline[start:], False)] if depth == 0 else [(headline, False)]


def _script_safe_json(value: Any) -> str:
    """Return a value as JSON text that may stand inside an HTML script element: ``<``, ``>`` and ``&`` are escaped.

    The line separators U+2028 and U+2029 are escaped too. NaN or infinity in the value raises ValueError.
    """
    written = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        written = written.replace(character, f"\\u{ord(character):04x}")
    return written


def _content_security_policy(scripts: list[str]) -> str:
    """Return the content security policy of a report page, an HTML meta value that the browser enforces.

    Only the given ``scripts`` (JavaScript texts) may run, identified by their SHA-256, and nothing is loaded from the
    network.
    """
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in hashes)
    return f"default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; script-src {allowed}"


def _template_file(name: str) -> str:
    """Return the text of the file ``name`` in the folder of page templates, without white space at its ends.

    The text is returned as it is; no template is rendered.
    """
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8").strip()
