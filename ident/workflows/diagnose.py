"""What the ident commands do: logs in; model.toml, result.json and report.html out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ident.data import load_all
from ident.diagnosis import diagnose
from ident.effects import catalogue
from ident.estimation import load_model, outliers
from ident.model import with_outlier_model as with_outliers
from ident.models import check_user_model, load_effects
from ident.results import Json, diagnosis_result, envelope, estimation_warnings
from ident.workflows.model_inputs import _posed, check_ahead
from ident.workflows.output import Say, validity, write_all


def diagnosis(
    model_path: Path,
    logs: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    *,
    rate: float | None = None,
    max_effects: int,
    effects_file: Path | None,
    thruster: str | None = None,
    robust: bool = False,
    horizon: float | None = None,
    command: str,
    say: Say,
) -> Json:
    """Find what the model lacks, and write the model that has it.

    ``effects_file``: candidates of the user's own; ``thruster``: the static curve's file that a vehicle's model was
    fitted with, or which one, where the model is a thruster's and the log has several; ``robust``: allow outliers;
    ``rate``: 10 rows a second by default, 50 on the bench; ``horizon``: s ahead that predictions are judged, 10 by
    default, 1 on the bench (the search does not look at it).
    """
    loaded, unseen = load_all(logs, validate)
    check_ahead(horizon, loaded, unseen)
    own = load_effects(effects_file) if effects_file else {}
    saved = load_model(model_path)
    # Maxima of the plain likelihood are compared, by a filter of first order: neither changes what is found, and on
    # that the blind tests were made.
    plain = replace(saved.model, second_order=False)
    model, runs, others, usual = _posed(plain, model_path, loaded, unseen, thruster)
    for effect in own.values():
        if effects_file is not None and model.accepts(effect):
            check_user_model(model + effect, effects_file)
    found = diagnose(
        with_outliers(model) if robust else model,
        runs,
        others,
        effects=catalogue() | own,
        rate=rate or usual,
        max_effects=max_effects,
        progress=say,
    )
    result = envelope([*loaded, *unseen], command) | diagnosis_result(found, horizon)
    if result["next_experiment"]:
        result["next_experiment"] = result["next_experiment"].replace("MODEL", str(model_path))
    result["notes"] = outliers(found.after) + result["notes"]
    result["cautions"] = estimation_warnings(found.after.fit, [v.record for v in found.after.estimation])
    write_all(out, result, found.after.fit, validity(found.after), effects_file or saved.effects_file)
    return result
