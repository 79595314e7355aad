"""Tests of the report: complete, safe and self-contained for any content of the result."""

from __future__ import annotations

import base64
import copy
import hashlib
import io
import itertools
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rich.console import Console

from seatrial.api.tables import conclusion
from seatrial.ident.report import drawing, formatting
from seatrial.ident.report.blocks import Cell, Section, Table
from seatrial.ident.report.page import Answer, compose, figure_page
from seatrial.ident.report.sections.answer import effect_card
from seatrial.ident.report.terminal import print_result
from seatrial.ident.results import NOT_WEIGHED, VehicleResult, standard_error_sentence
from tests.ident.pages import HOSTILE, KINDS, Page, loaded, numbers, printed, shortened, written

MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def diagnosis() -> dict[str, Any]:
    return KINDS["diagnosis"]()


@pytest.fixture(scope="module")
def small(diagnosis: dict[str, Any]) -> dict[str, Any]:
    """Return the diagnosis with short series."""
    return shortened(copy.deepcopy(diagnosis))


@pytest.fixture(scope="module")
def page(diagnosis: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Page:
    """Return the page of the diagnosis."""
    return Page(written(diagnosis, tmp_path_factory.mktemp("diagnosis")))


@pytest.mark.parametrize("kind", KINDS)
def test_page_loads_no_external_resource(kind: str, tmp_path: Path) -> None:
    text = written(shortened(KINDS[kind]()), tmp_path)
    page = Page(text)
    loading = {"src", "srcset", "poster", "data", "action", "background", "ping"}
    assert not [(tag, attrs) for tag, attrs in page.tags if loading & attrs.keys()]
    assert not [attrs for tag, attrs in page.tags if tag in ("link", "iframe", "object", "embed", "base")]
    links = [attrs["href"] for tag, attrs in page.tags if "href" in attrs]
    assert all(str(link).startswith("#") for link in links)
    style = text[text.index("<style>") : text.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_only_plotly_and_the_script_of_the_page_may_run(small: dict[str, Any], tmp_path: Path) -> None:
    page = Page(written(small, tmp_path))
    running = [text for attrs, text in page.scripts if attrs.get("type") != "application/json"]
    assert len([text for text in running if "* plotly.js (cartesian - minified) v" in text]) == 1
    assert len(running) == 2
    [policy] = [attrs["content"] for _, attrs in page.tags if attrs.get("http-equiv") == "Content-Security-Policy"]
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in running]
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert set(re.findall(r"sha256-([^']+)'", policy)) == set(digests)


@pytest.mark.parametrize(
    ("kind", "sections"),
    [
        (
            "diagnosis",
            [
                *("prediction", "errors", "traces", "run", "parameters", "residuals", "search", "calibration"),
                *("next", "notes", "made"),
            ],
        ),
        ("thruster", ["static", "prediction", "traces", "run", "parameters", "calibration", "made"]),
        ("noise", ["noise", "run", "made"]),
        ("navigation", ["outages", "navigation", "run", "notes", "made"]),
    ],
)
def test_every_section_with_data_is_present(kind: str, sections: list[str], tmp_path: Path) -> None:
    page = Page(written(shortened(KINDS[kind]()), tmp_path))
    assert page.headings() == sections
    places = [attrs["id"] for tag, attrs in page.tags if tag == "div" and attrs.get("class") == "plot"]
    assert sorted(map(str, places)) == sorted(page.figures())
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))


def test_answer_and_its_figures_come_first(diagnosis: dict[str, Any], page: Page) -> None:
    words = " ".join(page.words.split())
    start = words.index(diagnosis["answer"])
    first = words[: words.index("Predicted 10 s ahead against measured", start)]
    row = diagnosis["errors"]["validation"]["horizon"]["psi"]
    assert f"{np.degrees(row['before']):.2f} → {np.degrees(row['after']):.2f} deg" in first
    assert "f_i -= k_J |n_i| (u - y_i r)" in first
    assert "6.08 ± 0.27 kg/s" in first
    assert "42 % smaller prediction error 10 s ahead with this effect (95 %: 34 to 50 %)" in first
    assert "In wordsthe thrust falls by 6.1 N" in first


@pytest.mark.parametrize(
    ("ratio", "low", "high", "verdict", "shown"),
    [
        (0.25, 0.2, 0.5, "fell", "75 % smaller prediction error 10 s ahead with this effect (95 %: 50 to 80 %)"),
        (
            0.98,
            0.9,
            1.1,
            "unchanged",
            "\N{MINUS SIGN}2 % change of the prediction error 10 s ahead with this effect, not significant",
        ),
        (1.25, 1.1, 1.4, "rose", "25 % larger prediction error 10 s ahead with this effect"),
        (
            1.004,
            0.9996,
            1.02,
            "unchanged",
            "+0.4 % change of the prediction error 10 s ahead with this effect, not significant (95 %: +0.0 to +2.0 %)",
        ),
        (
            1.004,
            1.001,
            1.02,
            "rose",
            "0.4 % larger prediction error 10 s ahead with this effect (95 %: 0.1 to 2.0 %)",
        ),
        (
            0.5,
            None,
            None,
            "unchanged",
            "\N{MINUS SIGN}50 % change of the prediction error 10 s ahead with this effect, the data are",
        ),
    ],
)
def test_importance_is_the_change_over_the_horizon(
    ratio: float, low: float | None, high: float | None, verdict: str, shown: str, small: dict[str, Any]
) -> None:
    change = {"role": "validation", "ratio": ratio, "low": low, "high": high, "verdict": verdict}
    (effect, *_) = loaded(small | {"effects": [small["effects"][0] | {"prediction": change}]}).effects
    card = effect_card(effect, 10.0)
    assert f"{card.importance} {card.importance_words}".startswith(shown)


def test_attribution_of_a_card_is_a_list(small: dict[str, Any], tmp_path: Path) -> None:
    row = small["effects"][0] | {"attribution": "ambiguous", "reasons": ["first", "second"], "not_excluded": ["wind"]}
    (effect, *_) = loaded(small | {"effects": [row]}).effects
    points = dict(effect_card(effect, 10.0).facts)["Attribution"]
    assert points[:3] == ("ambiguous", "first", "second")
    assert points[3].startswith("not excluded, by ΔBIC")
    assert "<ul><li>ambiguous</li><li>first</li><li>second</li>" in written(small | {"effects": [row]}, tmp_path)


def test_terminal_says_that_the_mass_was_not_compared_with_a_weighed_one() -> None:
    bench = shortened(KINDS["thruster"]())
    fit = {name: bench[name] for name in bench if name in VehicleResult.__struct_fields__} | {"kind": "vehicle"}
    for notes in ([], [NOT_WEIGHED]):
        shown = Console(width=100, record=True, file=io.StringIO())
        print_result(loaded(fit | {"notes": notes}), shown)
        assert (NOT_WEIGHED in " ".join(shown.export_text().split())) == bool(notes)


def test_value_at_a_bound_is_marked_in_the_card_and_on_the_terminal(small: dict[str, Any]) -> None:
    parameter = {"name": "k_heat", "meaning": "lost share", "unit": "", "value": 0.9, "se": None, "at_bound": True}
    result = loaded(small | {"effects": [small["effects"][0] | {"parameters": [parameter]}]})
    ((name, value, _),) = effect_card(result.effects[0], 10.0).parameters
    assert (name, value) == ("k_heat", "0.9 (at its limit)")
    console = Console(width=100, record=True, file=io.StringIO())
    print_result(result, console)
    (line,) = [row for row in console.export_text().splitlines() if row.strip().startswith("k_heat")]
    assert "⚠ at its limit: lost share" in line


def test_figures_are_json_with_valid_arrays(page: Page) -> None:
    figures = page.figures()
    traces = [trace for figure in figures.values() for trace in figure["data"]]
    sizes = [len(numbers(trace["x"])) for trace in traces]
    assert sizes == [len(numbers(trace["y"])) for trace in traces]
    assert min(sizes) > 0
    assert max(sizes) <= 3100


def test_angles_are_wrapped_and_those_of_a_simulation_are_continuous(page: Page) -> None:
    """A simulation may leave the samples by any angle: at jumps, its band filled the panel."""
    figures = page.figures()
    firsts = {name: (f["layout"].get("annotations") or [{}])[0].get("text", "") for name, f in figures.items()}
    headings = [figures[name] for name, title in firsts.items() if "Heading" in title and "fit" in title]
    assert len(headings) == 4  # Predicted and simulated, for two records.
    predicted, simulated = ([f for f in headings if ("tick0" in f["layout"]["yaxis"]) == own] for own in (True, False))
    assert len(predicted) == len(simulated) == 2
    for figure in simulated:
        curves = [t for t in figure["data"] if t["yaxis"] == "y" and t["name"] in ("model", "before", "measured")]
        values = [numbers(trace["y"]) for trace in curves]
        assert len(values) >= 2
        assert max(np.abs(np.diff(y[np.isfinite(y)])).max() for y in values) < 90
        starts = [y[np.isfinite(y)][0] for y in values]
        assert np.ptp(starts) < 180.0
        assert max(np.nanmax(np.abs(y)) for y in values) > 180.0
    for figure in predicted:
        assert figure["layout"]["yaxis"]["range"] == pytest.approx([-180.0, 180.0])
        for trace in figure["data"]:
            y = numbers(trace["y"])
            if trace["yaxis"] == "y" and trace["name"] in ("model", "before", "measured"):
                assert np.nanmax(np.abs(y)) <= 180.001
                assert np.isnan(y).any()
                assert np.nanmax(np.abs(np.diff(y))) < 90


def test_diverged_simulation_is_cut_and_reported(diagnosis: dict[str, Any], tmp_path: Path) -> None:
    result = copy.deepcopy(diagnosis)
    [row] = [t for t in result["traces"] if t["record"] == "afternoon" and t["channel"] == "x"]
    row["model"] = [y if k < 400 else 1e6 * (k - 400) for k, y in enumerate(row["model"])]
    row["diverged"] = 40.0
    result["errors"]["validation"]["simulation"]["x"]["after"] = None
    page = Page(written(result, tmp_path))
    titles = [a["text"] for f in page.figures().values() for a in f["layout"].get("annotations", [])]
    [title] = [t for t in titles if t.endswith("simulation diverged after 40 s")]
    assert "north" in title
    assert "diverged" in " ".join(page.words.split())
    drawn = [numbers(t["y"]) for f in page.figures().values() for t in f["data"] if t.get("name") == "model"]
    assert max(np.nanmax(y) for y in drawn) < 1e4


def test_page_of_a_long_result_stays_small(diagnosis: dict[str, Any], tmp_path: Path) -> None:
    many = copy.deepcopy(diagnosis)
    for key in ("traces", "residuals", "residual_forces", "inputs", "track", "cross"):
        many[key] = [{**row, "record": f"{row['record']} {i}"} for i in range(3) for row in diagnosis[key]]
    for result in (diagnosis, many):
        assert len(written(result, tmp_path).encode()) < 8 * MEGABYTE


def hostile(value: Any) -> Any:
    """Replace every text of a result, except the keys that select its type."""
    if isinstance(value, dict):
        keep = ("format", "kind", "role", "method", "attribution", "verdict", "outcome")
        return {k: v if k in keep else hostile(v) for k, v in value.items()}
    if isinstance(value, list):
        return [hostile(item) for item in value]
    return HOSTILE if isinstance(value, str) else value


def test_a_long_headline_is_smaller_and_its_sizes_more_so(tmp_path: Path) -> None:
    """A headline of three effects with their sizes took 16 lines of a phone."""
    result = KINDS["diagnosis"]()
    result["answer"] = (
        "The model lacks thrusters that do not push straight ahead (toe-in (or a bent mount)) (the right one pushes "
        "9.3 ± 1.2 deg to starboard (outwards)) and steady wind."
    )
    text = written(result, tmp_path)
    head = text[text.index("<h1") : text.index("</h1>")]
    assert head.startswith('<h1 class="long">')
    (size,) = re.findall("<small>(.*?)</small>", head)
    assert " ".join(size.split()) == "(the right one pushes 9.3 ± 1.2 deg to starboard (outwards))"
    result["answer"] = "The model lacks steady wind (3 N)."
    assert "<h1>The model lacks steady" in written(result, tmp_path)


def test_sizes_of_effects_in_a_long_headline_are_a_list(tmp_path: Path) -> None:
    """The headline then has some lines on a phone. A size with other words stays in the headline."""
    result = KINDS["diagnosis"]()
    effect = result["effects"][0]
    sizes = {
        "the loss of thrust (by the battery)": "the thrust is 12 ± 2 % smaller at the end of the run",
        "steady wind": "10.0 ± 0.5 N on the broadside, from 53 deg",
    }
    result["effects"] = [effect | {"title": t, "in_words": w} for t, w in sizes.items()]
    (first, small), (second, _) = sizes.items()
    more = "Prediction: the error falls."
    result["answer"] = f"The model lacks {first} ({small}), and also {second} (its size is not determined). {more}"
    text = written(result, tmp_path)
    head = re.sub(r"<.*?>", "", text[text.index("<h1") : text.index("</h1>")]).strip()
    assert head == f"The model lacks {first}, and also {second} (its size is not determined)."
    lines = [" ".join(x.split()) for x in re.findall(r"<li><b>(.*?)</li>", text[: text.index(more)])]
    assert lines == [f"The loss of thrust (by the battery)</b>: {small}"]
    assert text.count("± is one standard error.") == 1
    result["answer"] = f"The model lacks {second}."
    assert '<ul class="sizes">' not in written(result, tmp_path)


def test_plus_minus_in_an_answer_is_explained_once() -> None:
    result = KINDS["diagnosis"]() | {"answer": "The model lacks steady wind (3.0 ± 0.4 N).", "caveat": None}
    assert printed(result).count("± is one standard error.") == 1
    assert standard_error_sentence("The model lacks steady wind (3 N).", None) == ""
    assert conclusion(loaded(result)) == "The model lacks steady wind (3.0 ± 0.4 N). ± is one standard error."


def test_caption_of_a_table_is_below_it_and_begins_at_its_left(small: dict[str, Any], tmp_path: Path) -> None:
    (rule,) = re.findall(r"(?m)^caption \{([^}]*)\}", written(small, tmp_path))
    assert {"caption-side: bottom", "text-align: left"} <= {part.strip() for part in rule.split(";")}


def test_rows_of_a_stacked_table_have_titled_cells() -> None:
    """A narrow screen shows these titles, where the verdict of a comparison was out of sight."""
    table = Table((("model", ""), ("verdict", "")), [["(a)", Cell("better", "good")]], stacked=True)
    section = Section("answer", "", [table])
    text = compose("Comparison", Answer("Good."), section, [], {}, version="1")
    assert '<table class="stacked">' in text
    assert '<td class="good" data-title="verdict">better' in text
    whole = Section("answer", "", [replace(table, stacked=False)])
    plain = compose("Comparison", Answer("Good."), whole, [], {}, version="1")
    assert "data-title=" not in plain.partition("</style>")[2]


@pytest.mark.parametrize("kind", KINDS)
def test_text_from_a_log_is_escaped(kind: str, tmp_path: Path) -> None:
    result = hostile(shortened(KINDS[kind]()))
    if "errors" in result:
        result["errors"]["estimation"]["simulation"] = {HOSTILE: {"before": 2.0, "after": 1.0, "unit": HOSTILE}}
    text = written(result, tmp_path)
    page = Page(text)
    assert "<script>alert" not in text
    assert not [tag for tag, attrs in page.tags if tag == "img" or "onerror" in attrs]
    assert len(page.scripts) == 3
    assert HOSTILE in page.words
    shown = json.dumps(page.figures(), ensure_ascii=False)
    assert "<script" not in shown.replace("\\u003c", "<")
    assert printed(result)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every key of a result, including the first row of every list."""
    if isinstance(value, dict):
        return [p for key, item in value.items() for p in [(*path, key), *places(item, (*path, key))]]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return places(value[0], (*path, 0))
    return []


def changed(result: dict[str, Any], changes: list[tuple[tuple[Any, ...], Any]]) -> dict[str, Any]:
    """Return a copy of a result with replaced values.

    The value KeyError removes the key. Paths that do not exist any more are skipped.
    """
    new = copy.copy(result)
    for path, value in changes:
        owner: Any = new
        try:
            for step in path[:-1]:
                owner[step] = copy.copy(owner[step])
                owner = owner[step]
            owner.pop(path[-1]) if value is KeyError else owner.update({path[-1]: copy.copy(value)})
        except (KeyError, IndexError, TypeError, AttributeError):
            continue
    return new


POOR = (KeyError, None, [], {}, "text", float("nan"), True, -1)


def refusal(result: dict[str, Any]) -> str:
    try:
        loaded(result)
    except msgspec.ValidationError as error:
        return str(error)
    return ""


# `share` is the share of keys below the first level that are tested, drawn by a seed. Each needs one page.
@pytest.mark.parametrize("share", [0.05, pytest.param(0.2, marks=pytest.mark.study)])
@pytest.mark.parametrize("kind", ["diagnosis", "thruster"])
def test_missing_numbers_are_left_out_and_invalid_values_are_named(
    kind: str, share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without this, each of many pages would have 1.5 MB.
    monkeypatch.setattr("seatrial.ident.report.page.PLOTLY", "report.js")
    result = shortened(KINDS[kind]())
    every, n_drawn, rng = places(result), 0, np.random.default_rng(7)
    poor = [value for value in POOR if value == value]  # JSON has no NaN.
    some = {path: poor if len(path) == 1 else [poor[rng.integers(len(poor))]] for path in every}
    some = {path: values for path, values in some.items() if len(path) == 1 or rng.random() < share}
    for path, value in ((path, value) for path, values in some.items() for value in values):
        poorer = changed(result, [(path, value)])
        if refused := refusal(poorer):
            assert any(str(step) in refused for step in path), f"{path} {value}: {refused}"
            continue
        n_drawn += 1
        assert "</html>" in written(poorer, tmp_path), f"fails on {path} {value}"
        assert printed(poorer)
    assert n_drawn > len(some) / 8


def test_minimal_result_gives_a_page(tmp_path: Path) -> None:
    static = {key: [] for key in ("n", "force", "sd", "n_model", "force_model", "force_sd")}
    made = {"created": "", "seatrial": "", "command": ""}
    least = made | {"kind": "thrust_curve", "answer": "Nothing.", "static": static}
    page = Page(written(least, tmp_path))
    assert "Nothing." in page.words
    assert page.headings() == ["static"]
    assert printed(least).split() == ["Nothing."]


def test_terminal_shows_the_key_figures(diagnosis: dict[str, Any]) -> None:
    text = printed(diagnosis)
    lines = text.splitlines()
    assert len(lines) <= 42
    assert max(map(len, lines)) <= 80
    for words in ("6.08 ± 0.27", "loss of thrust with forward speed", "15.1 → 4.75", "deg/s", "simulation"):
        assert words in text


def test_terminal_shows_the_probability_of_a_name_and_what_sorts_the_candidates(
    diagnosis: dict[str, Any], tmp_path: Path
) -> None:
    assert "Names of the effects" not in printed(diagnosis)
    result = copy.deepcopy(diagnosis)
    result["effects"][0]["probability"] = 0.988
    text = " ".join(printed(result).split())
    name = (
        "Names of the effects: identified: loss of thrust with forward speed. On simulated boats with known effects, "
        "99 % of the names that were identified were right; this is no probability for your boat."
    )
    assert text.index("72 % of the error on new data.") < text.index(name) < text.index("Parameters")
    assert "Look for" not in text
    result["effects"][0]["causes"] = "a worn propeller"
    causes = "Look for the cause of loss of thrust with forward speed: a worn propeller."
    assert causes in " ".join(printed(result).split())
    assert "best by score/df" in text
    wide = next(c for c in result["rounds"][0]["candidates"] if c["df"] == 6)
    row = next(line for line in printed(result).splitlines() if " X(u) " in line)
    assert "X(u): surge force that follows the surge speed" in text  # below the table
    assert row.split("X(u)")[1].split()[:3] == [f"{wide['lm']:.0f}", "6", f"{wide['lm'] / 6:.0f}"]
    page = " ".join(Page(written(result, tmp_path)).words.split())
    assert f"{wide['lm']:.0f} on 6 df ({wide['lm'] / 6:.0f} per df)" in page


@pytest.mark.parametrize("fit", ["before", "after"])
def test_fit_that_did_not_converge_has_no_headline(fit: str, diagnosis: dict[str, Any], tmp_path: Path) -> None:
    result = shortened(copy.deepcopy(diagnosis)) | {"answer": "The fit did not converge: it stopped."}
    if fit == "after":
        result["fit"]["converged"] = False
    else:
        result["converged_before"] = False
    words = " ".join(Page(written(result, tmp_path)).words.split())
    first = words[words.index("The fit did not converge") : words.index("Predicted 10 s ahead against measured")]
    assert "6.08" not in first
    assert "before → after" not in first
    assert printed(result).split()[0] == "⚠"
    assert not loaded(result).converged


@pytest.mark.parametrize(
    ("cross_validated", "in_blocks", "how"),
    [
        (False, False, "the model is fitted again by plain maximum likelihood"),
        (False, True, "each block of time of a validation log is predicted with estimates from the others"),
        (True, False, "each block of time of the estimation logs is predicted by a fit to the others"),
    ],
)
def test_errors_of_a_diagnosis_say_which_command_gives_comparable_ones(
    small: dict[str, Any], cross_validated: bool, in_blocks: bool, how: str, tmp_path: Path
) -> None:
    content = small | {"cross_validated": cross_validated, "validated_in_blocks": in_blocks}
    words = "Comparable errors of both models: `seatrial ident compare MODEL DIAGNOSIS --on LOG`."
    shown = " ".join(printed(content).split())
    table = shown[shown.index("Error before → after") :]
    assert how in table
    assert words in table
    text = " ".join(written(content, tmp_path).split())
    section = text[text.index('<section id="errors"') : text.index('<section id="traces"')]
    section = re.sub(r'<span class="option">(.*?)</span>', r"\1", section)
    assert how in section
    assert words.replace(" `", " <code>").replace("`.", "</code>.") in section
    assert "Comparable" not in printed(shortened(KINDS["thruster"]()))


def without_effects(small: dict[str, Any]) -> dict[str, Any]:
    """Return the diagnosis without an added effect: errors and parameters after are those before."""
    result = copy.deepcopy(small) | {"effects": [], "rounds": [], "prediction": None}
    for row in result["parameters_before_after"]:
        row |= {"after": row["before"], "after_se": row["before_se"]}
    for kinds in result["errors"].values():
        for row in (row for kind in kinds.values() for row in kind.values()):
            row["after"] = row["before"]
    return result


def test_page_of_a_diagnosis_that_adds_nothing_compares_nothing(small: dict[str, Any], tmp_path: Path) -> None:
    """It had a table with a change of 0.0 s.e. in each row, and ``fit 59 % → 59 %`` in the titles of the panels."""
    for name, content, compares in (("added", small, True), ("nothing", without_effects(small), False)):
        folder = tmp_path / name
        folder.mkdir()
        page = Page(written(content, folder))
        assert ("change in standard errors of the value before" in page.words) is compares
        titles = re.findall(r"fit [^\"<]*?%(?: → [^\"<]*?%)?", json.dumps(page.figures(), ensure_ascii=False))
        assert titles
        assert any("→" in title for title in titles) is compares


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("unchanged", "is not significantly better or worse with them"),
        ("rose", "The prediction over the horizon is worse with them."),
    ],
)
def test_errors_that_differ_by_common_errors_alone_are_explained(
    small: dict[str, Any], verdict: str, words: str
) -> None:
    """The errors rose under the answer that no effect is missing, without a word on the cause."""
    change = {
        "role": "validation",
        "ratio": 1.1,
        "low": 0.8,
        "high": 1.6,
        "verdict": verdict,
        "better": [],
        "worse": [],
    }
    common = {"names": ["lift"], "titles": ["hull lift"], "gain": 9.0, "df": 1, "validation_gain": 4.0, "t": 2.5}
    common |= {"prediction": change, "parameters": []}
    result = copy.deepcopy(small) | {"effects": [], "prediction": None, "common_errors": common}
    begin = "No effect was added: the errors differ because the small errors that every craft has (common errors) were"
    shown = " ".join(printed(result).split())
    assert begin in shown
    assert words in shown
    given = common | dict.fromkeys(("gain", "df", "validation_gain", "t", "prediction"))
    for content in (result | {"common_errors": given}, small | {"common_errors": common}):
        assert begin not in " ".join(printed(content).split())


def test_terminal_shows_the_units_of_outages() -> None:
    words = " ".join(printed(KINDS["navigation"]()).split())
    assert "from [s] for [s] 95 % radius [m] error [m] allowed [m]" in words


def test_important_warnings_come_before_the_answer() -> None:
    changes = {
        "answer": "Done.",
        "warnings": [
            {"code": "arm-unknown", "text": "Nobody gave the arms."},
            {"code": "stuck-sensor", "text": "gauge: a stuck sensor?"},
        ],
    }
    words = printed(KINDS["thruster"]() | changes)
    assert words.index("⚠ Nobody gave the arms.") < words.index("⚠ gauge: a stuck sensor?")
    assert words.index("⚠ gauge") < words.index("Done.")


def test_flag_wraps_and_numbers_do_not() -> None:
    flag = "not identified: the data do not depend on the joint change -1 c1 +1 c2 and of five more that go with them"
    result = shortened(KINDS["thruster"]())
    row = {"name": "c1", "meaning": "", "value": 0.45, "se": 0.031, "unit": "m", "free": True, "flag": flag}
    result["fit"]["parameters"] = [row]
    text = printed(result)
    assert "0.450 ± 0.031" in text
    assert flag in " ".join(re.sub(r"c1 +0.450 ± 0.031 +m", "", text).split())
    assert max(map(len, text.splitlines())) <= 80
    wide = io.StringIO()  # a pipe or a file has no limit of width
    print_result(loaded(result), Console(file=wide, width=10_000, color_system=None))
    (heading,) = (k for k, line in enumerate(wide.getvalue().splitlines()) if line.strip().startswith("Parameters"))
    table = [line.rstrip() for line in wide.getvalue().splitlines()[heading : heading + 6]]
    assert "c1" in " ".join(table)
    assert max(map(len, table)) <= 100


def test_page_and_terminal_count_the_same_parameters_as_not_shown(tmp_path: Path) -> None:
    more = copy.deepcopy(KINDS["thruster"]())
    row = next(r for r in more["fit"]["parameters"] if r["free"] and "noise" not in r["meaning"])
    more["fit"]["parameters"] += [row | {"name": f"k{i}", "se": None if i % 2 else 1.0} for i in range(12)]
    (terminal,) = re.findall(r"Parameters \((\d+) more in the report\)", printed(more))
    (page,) = re.findall(r"(\d+) more below", Page(written(more, tmp_path)).words)
    assert page == terminal


def test_parameters_of_a_requested_effect_come_first() -> None:
    bench = copy.deepcopy(KINDS["thruster"]())
    result = {name: bench[name] for name in bench if name in VehicleResult.__struct_fields__} | {"kind": "vehicle"}
    row = next(r for r in result["fit"]["parameters"] if r["free"])
    requested = row | {"name": "eps_LR", "meaning": "relative difference", "unit": ""}
    result["fit"]["parameters"] += [*(row | {"name": f"k{i}"} for i in range(12)), requested]
    assert "eps_LR" not in printed(result)
    result["effect_parameters"] = ["eps_LR"]
    lines = printed(result).split("Parameters")[1].splitlines()
    assert lines[3].split()[0] == "eps_LR"


def test_parameters_of_waves_in_a_diagnosed_model_are_printed(small: dict[str, Any]) -> None:
    """They were among those that only the report has, behind masses and damping."""
    result = copy.deepcopy(small)
    row = next(r for r in result["fit"]["parameters"] if r["free"])
    result["fit"]["parameters"] += [*(row | {"name": f"k{i}"} for i in range(12)), row | {"name": "f_wave"}]
    assert "f_wave" not in printed(result)
    names = [line.split()[0] for line in printed(result).split("Parameters")[1].splitlines()[3:12] if line.strip()]
    result["environment_parameters"] = ["f_wave"]
    text = printed(result)
    lines = [line.split()[0] for line in text.split("Parameters")[1].splitlines()[3:12] if line.strip()]
    added = len({p["name"] for e in result["effects"] for p in e["parameters"]} & set(names))
    assert lines[added] == "f_wave"  # after those of the added effects
    assert lines[:added] == names[:added]


def test_removed_effect_is_not_shown_as_added(small: dict[str, Any], tmp_path: Path) -> None:
    result = copy.deepcopy(small)
    name = result["rounds"][0]["chosen"]
    gone = {"name": name, "title": name, "validation_gain": 1.0, "t": 0.3, "prediction": None}
    assert "✓" in printed(result)
    assert "removed again" not in Page(written(result, tmp_path)).words
    result |= {"removed_effects": [gone], "effects": [e for e in result["effects"] if e["name"] != name]}
    text = printed(result)
    assert "−" in text.split("First round")[1].split("− added and removed again")[0]
    page = tmp_path / "again"
    page.mkdir()
    words = " ".join(Page(written(result, page)).words.split())
    assert f"Round 1: {name}, removed again" in words
    assert "This effect was removed again" in words


def test_statistical_errors_are_marked_on_the_page(small: dict[str, Any], tmp_path: Path) -> None:
    result = copy.deepcopy(small)
    for only in (False, True):
        result["fit"]["scale"] = {"statistical_only": only}
        folder = tmp_path / str(only)
        folder.mkdir()
        assert ("± s.e. (statistical only)" in Page(written(result, folder)).words) is only


def test_per_record_parameter_names_its_run_and_comes_last(tmp_path: Path) -> None:
    result = shortened(KINDS["thruster"]())
    row = {"meaning": "current", "value": 0.1, "se": 0.01, "unit": "m/s", "free": True}
    rows = [row | {"name": "V_x", "record": run} for run in ("run1", "run2")]
    result["fit"]["parameters"] = [*rows, row | {"name": "m_u", "meaning": "mass", "unit": "kg"}]
    text = printed(result)
    assert text.index("m_u") < text.index("current, run1") < text.index("current, run2")
    page = Page(written(result, tmp_path)).words
    cards = page[: page.index("± is one standard error")]
    assert "m_u = 0.100 ± 0.010 kg" in " ".join(cards.split())
    assert "V_x" not in cards


def test_terminal_shows_profile_intervals() -> None:
    row: dict[str, Any] = {"name": "psi_0", "unit": "rad", "value": 0.1, "low": 0.05, "high": None}
    row |= {"wald_low": 0.04, "wald_high": 0.2}
    row |= {"grid": [0.05, 0.1], "drop": [1.92, 0.0], "notes": ["upper side: no end"]}
    lines = printed(KINDS["thruster"]() | {"profiles": [row]}).splitlines()
    (line,) = [" ".join(text.split()) for text in lines if "psi_0" in text]
    assert line == "psi_0 5.73 2.86 to open 2.29 to 11.5 deg upper side: no end"


def test_label_does_not_repeat_the_signal_name() -> None:
    assert formatting.named("voltage_left") == "voltage left"
    assert formatting.named("n_left") == "shaft speed left n_left"


@pytest.mark.parametrize(
    ("value", "se", "shown"),
    [
        (40.0512, 0.1234, "40.05 ± 0.12"),
        (12345.0, 234.0, "12340 ± 230"),
        (-3.2e-6, 4.4e-7, "(−3.20 ± 0.44) ×10⁻⁶"),
        (0.0, 0.05, "0.000 ± 0.050"),
        (9.96, 0.0996, "9.96 ± 0.10"),
        (0.4, None, "0.4"),
        (100.0, None, "100"),
        (None, None, "–"),
    ],
)
def test_standard_error_sets_the_digits(value: float | None, se: float | None, shown: str) -> None:
    assert formatting.with_error(value, se) == shown


@pytest.mark.parametrize(
    ("unit", "shown", "factor"),
    [
        ("rad", "deg", 180 / np.pi),
        ("rad/s", "deg/s", 180 / np.pi),
        ("rad/s/sqrt(s)", "deg/s/√s", 180 / np.pi),
        ("rad2/Hz", "deg²/Hz", (180 / np.pi) ** 2),
        ("kg m2/s", "kg m²/s", 1.0),
        ("N m/rad", "N m/rad", 1.0),
        ("radish", "radish", 1.0),
        ("1", "", 1.0),
    ],
)
def test_radians_become_degrees(unit: str, shown: str, factor: float) -> None:
    assert formatting.degrees_for(unit) == (pytest.approx(factor), shown)


def test_thinning_keeps_the_extremes() -> None:
    y = np.random.default_rng(1).standard_normal(100_003)
    y[70_001], y[500] = 40.0, np.nan
    at = drawing.thinned(y, 1000)
    assert at.size <= 1002
    assert (at[0], at[-1]) == (0, y.size - 1)
    assert np.nanmax(y[at]) == 40.0
    assert np.nanmin(y[at]) == np.nanmin(y)


def test_warnings_follow_the_headline_and_the_rest_of_the_answer(tmp_path: Path) -> None:
    result = KINDS["diagnosis"]()
    result["answer"] = "The model lacks steady wind. Take it with care."
    result["warnings"] = [{"code": "log-check", "text": "The log has gaps."}]
    text = written(result, tmp_path)
    assert (
        text.index("</h1>") < text.index("Take it with care.</p>") < text.index("The log has gaps.") < text.index("<h2")
    )


def test_no_line_breaks_inside_an_option_of_the_command_line(tmp_path: Path) -> None:
    """On a phone, --effect was broken after its first hyphen. The copied text must stay the option."""
    result = KINDS["diagnosis"]()
    result["answer"] = (
        "The model lacks wind. Add it (--effect wind), or `seatrial ident diagnose --no-score-tests A--b`."
    )
    text = written(result, tmp_path)
    assert '(<span class="option">--effect</span> wind)' in text
    assert 'diagnose <span class="option">--no-score-tests</span> A--b</code>' in text
    assert ".option { white-space: nowrap; }" in text
    result["answer"] = "The model lacks <b>wind</b> --effect."
    assert '&lt;b&gt;wind&lt;/b&gt; <span class="option">--effect</span>.' in written(result, tmp_path)


def test_page_of_a_figure_has_no_empty_heading_and_no_empty_link() -> None:
    text = figure_page("Speed", {"data": [{"type": "scatter", "x": [0, 1], "y": [0, 1]}], "layout": {}})
    assert "Speed" in text
    assert not re.search(r"<h2>\s*</h2>", text)
    assert not re.search(r"<a [^>]*>\s*</a>", text)


def test_steps_keep_their_shape_with_few_points() -> None:
    t = 0.2 * np.arange(1400.0)
    y = np.where(t % 50.0 < 17.0, 0.6, -0.2) * (t > 3.0)
    y[700] = np.nan
    at = drawing.corners(t, y, 60)
    assert at.size <= 60
    good = np.isfinite(y)
    np.testing.assert_allclose(np.interp(t, t[at], y[at])[good & (np.abs(t - 140.0) > 0.3)][:650], y[good][:650])
    assert {699, 700, 701} <= set(at)
    assert np.abs(np.interp(t, t[drawing.thinned(y, 60)], y[drawing.thinned(y, 60)]) - y)[good].max() > 0.1


def in_blocks(diagnosis: dict[str, Any], n: int) -> dict[str, Any]:
    """Return the diagnosis, without its validation logs, on n blocks of its first log that were left out of the fit."""
    result = copy.deepcopy(diagnosis)
    name = next(log["name"] for log in result["logs"] if log["role"] == "estimation")
    result["logs"] = [log for log in result["logs"] if log["role"] == "estimation"]
    for key in ("traces", "track", "inputs", "residuals", "residual_forces", "cross"):
        result[key] = [row for row in result[key] if row["record"] == name]
    for key in ("traces", "track", "inputs"):
        for i, row in itertools.product(range(n), list(result[key])):
            block = {**row, "record": f"{name}[{i}:{i + 1}]", **({"role": "validation"} if "role" in row else {})}
            for field, value in row.items():
                if isinstance(value, list):
                    block[field] = value[i * len(value) // n : (i + 1) * len(value) // n]
            result[key].append(block)
    return result


def test_blocks_of_a_log_share_a_tab(diagnosis: dict[str, Any], tmp_path: Path) -> None:
    result = in_blocks(diagnosis, 5)
    name = result["logs"][0]["name"]
    text = written(result, tmp_path)
    page = Page(text)
    assert f"blocks of time · {name}, 5 blocks" in page.words
    assert f"{name}[" not in text
    inputs = [f for f in page.figures().values() if "n_" in str(f["layout"].get("annotations", ""))]
    assert len(inputs) == 1
    drawn = [t for f in page.figures().values() for t in f["data"] if t.get("name") == "model" and "xaxis" in t]
    gaps = [int(np.isnan(np.array(numbers(t["y"]), dtype=float)).sum()) for t in drawn]
    assert gaps.count(4) >= len({t["channel"] for t in result["traces"]})


def test_angle_of_each_block_is_beside_the_samples() -> None:
    t = np.arange(10.0)
    angle = np.array([0.0, 100.0, 200.0, 300.0, np.nan, 700.0, 710.0, np.nan, -350.0, -360.0])
    shifted = drawing.beside(t, angle, t, np.zeros(10))
    np.testing.assert_allclose(shifted, [0, 100, 200, 300, np.nan, -20, -10, np.nan, 10, 0])


@pytest.mark.parametrize("in_blocks", [False, True])
def test_no_label_of_a_page_names_validation_data_without_validation_logs(
    small: dict[str, Any], in_blocks: bool, tmp_path: Path
) -> None:
    """Tables and figures of a diagnosis without --validate are about blocks of time of the estimation logs."""
    content = copy.deepcopy(small) | {"cross_validated": in_blocks, "notes": [], "caveat": None}
    for row in content["rounds"]:
        row["why"] = ""
    if in_blocks:
        for row in content["logs"]:
            row["role"] = "estimation"
    shown = printed(content)
    page = re.sub(r"<(script|style)\b.*?</\1>", "", written(content, tmp_path), flags=re.S)
    page = re.sub(r"<[^>]+>", " ", page)
    named = [text.count("blocks of time") for text in (shown, page)]
    wrong = [len(re.findall("validation data", text, re.I)) for text in (shown, page)]
    assert (min(named) > 0, max(wrong) == 0) == (in_blocks, in_blocks)
