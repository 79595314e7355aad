"""Tests of the sentence on a standard error that is larger than that of the prior."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import seatrial as st
from seatrial.daq.errors import SeatrialWarning
from seatrial.ident.estimation.given_priors import exceeded_prior, given_prior_flags
from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.export.formats import export
from seatrial.ident.model import Flag, Parameter, ParameterOrigin
from seatrial.ident.results.answers import prior_notes
from seatrial.ident.results.parts import FitSummary, ParameterRow
from seatrial.ident.results.tables import fit_summary
from tests.missions import boat_log, boat_with

pytestmark = pytest.mark.usefixtures("quick_compilation")
LARGER = "its standard error is larger than the given one"


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> st.FittedVehicle:
    log = boat_log(tmp_path_factory.mktemp("prior") / "run.mcap", boat_with(None, 5), 60.0, 101, 1)
    with pytest.warns(SeatrialWarning):
        return st.fit(log, priors={"c1": (40.0, 2.0)}, fixed={"c2": 1.1}, score_tests=False)


def with_error(fit: Fit, name: str, factor: float) -> Fit:
    """Return the fit with another standard error of a parameter: that of its prior times a factor."""
    errors, k = fit.errors.copy(), fit.names.index(name)
    prior = fit.parameters[k].prior
    assert prior is not None
    errors[k] = factor * prior[1]
    return replace(fit, errors=errors)


def row_of(summary: FitSummary, name: str) -> ParameterRow:
    (row,) = (row for row in summary.parameters if row.name == name)
    return row


def test_a_larger_error_is_explained_and_a_smaller_one_is_not(fitted: st.FittedVehicle) -> None:
    fit = fitted.fitted.fit
    for factor in (0.5, 1.0, np.nan):
        summary = fit_summary(with_error(fit, "c1", factor), {})
        assert LARGER not in (row_of(summary, "c1").flag or "")
    summary = fit_summary(with_error(fit, "c1", 1.2), {})
    flag = row_of(summary, "c1").flag or ""
    assert flag.startswith("given 40 ± 2 N; the data have ")
    assert f" ± 2.4 N; {LARGER}, as it contains what the model does not explain" in flag
    assert "of its information comes from its prior" not in flag  # the line has the share of the data
    assert [row.name for row in summary.parameters if LARGER in (row.flag or "")] == ["c1"]


def test_one_line_has_what_was_given_what_the_data_say_and_the_fit(fitted: st.FittedVehicle, tmp_path: Path) -> None:
    c1 = Parameter("c1", 29.0, "N", transform="log", prior=(29.0, 1.1), origin=ParameterOrigin.PRIOR)
    (line,) = given_prior_flags(c1, (29.28, 1.09), 0.98)
    assert line == (
        "given 29 ± 1.1 N; the data have 2 % of the information, too little for a value of their own; "
        "fitted 29.28 ± 1.09 N"
    )
    assert given_prior_flags(c1, (30.0, 0.7), 0.5) == ()  # nothing is unusual
    wide = "; ".join(given_prior_flags(replace(c1, transform="none"), (30.0, 1.4), 0.5))
    assert wide.startswith("given 29 ± 1.1 N; the data alone say about 31 N; fitted 30 ± 1.4 N; its standard error is")
    assert given_prior_flags(replace(c1, origin=ParameterOrigin.BUILT_IN), (29.28, 2.8), 0.98) == ()
    text = (fitted.save(tmp_path) / "model.toml").read_text(encoding="utf-8")
    flag = row_of(fitted.result.fit, "c1").flag
    assert flag is not None
    assert f'flag = "{flag}"' in text


def test_the_standard_deviation_is_quoted_as_it_was_given() -> None:
    """The search uses the logarithm of c1, whose standard deviation is relative to the mean of the prior."""
    c1 = Parameter("c1", 29.0, "N", transform="log", prior=(29.0, 1.06), origin=ParameterOrigin.PRIOR)
    for value in (27.9, 29.0, 29.47):
        assert exceeded_prior(c1, value, 2.04) == 1.06
        assert exceeded_prior(c1, value, 1.06) is None
    assert exceeded_prior(c1, 14.5, 0.8) is None  # smaller than what was given, although the logarithm is less certain
    assert exceeded_prior(c1, 58.0, 2.0) is None  # the same share of a larger estimate


@pytest.mark.parametrize("target", ["python", "c", "casadi"])
def test_an_exported_model_explains_a_larger_error(fitted: st.FittedVehicle, target: str, tmp_path: Path) -> None:
    model = load_model(fitted.save(tmp_path) / "model.toml")
    for factor in (0.9, 1.2):
        text = export(replace(model, errors={**model.errors, "c1": factor * 2.0}), target)
        header = " ".join(text.replace("#", " ").replace("*", " ").split())
        explained = "Standard error larger than that of the prior: c1 (2.4 > 2), because it also contains what the"
        assert (explained in header) == (factor > 1.0)


def test_a_kept_value_of_the_bench_has_a_note_in_place_of_a_flag(fitted: st.FittedVehicle) -> None:
    fit = fitted.fitted.fit
    value, _ = fit.estimate("c1")
    c1 = replace(fit.model.parameter("c1"), prior=(value, 2.0), origin=ParameterOrigin.MEASURED)
    measured = replace(fit, model=fit.model.replace_parameters(c1), flags=(("c1", Flag("prior", "99 % of its")),))
    for factor in (1.0, 1.2):
        changed = with_error(measured, "c1", factor)
        assert row_of(fit_summary(changed, {}), "c1").flag is None
        notes = [note for note in prior_notes(changed) if "larger than on the bench" in note]
        assert notes == ["The standard error of c1 is larger than on the bench: what the model does not explain is "
                         "included."] * (factor > 1.0)  # fmt: skip


def test_a_built_in_prior_does_not_count(fitted: st.FittedVehicle) -> None:
    """Built-in priors do not describe this boat."""
    fit = fitted.fitted.fit
    built_in = [p.full_name for p in fit.parameters if p.prior is not None and p.origin not in ("prior", "measured")]
    assert built_in
    for name in built_in:
        summary = fit_summary(with_error(fit, name, 3.0), {})
        assert not any(LARGER in (row.flag or "") for row in summary.parameters)


def test_summary_and_report_contain_the_sentence(fitted: st.FittedVehicle, tmp_path: Path) -> None:
    wide = replace(fitted.fitted, fit=with_error(fitted.fitted.fit, "c1", 1.2))
    result = fitted.result
    changed = st.FittedVehicle(type(result)(**{**_fields(result), "fit": fit_summary(wide.fit, {})}), wide)
    assert LARGER in " ".join(changed.summary().split())
    assert LARGER not in " ".join(fitted.summary().split())
    changed.save(tmp_path / "wide")
    assert LARGER in (tmp_path / "wide/report.html").read_text(encoding="utf-8")


def _fields(result: object) -> dict[str, object]:
    return {name: getattr(result, name) for name in type(result).__struct_fields__}  # type: ignore[attr-defined]
