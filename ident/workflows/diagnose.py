"""What the ident commands do: logs in; model.toml, result.json and report.html out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from seatrial.ident.checks import device_faults
from seatrial.ident.data import WHOLE, TimeWindow, load_all
from seatrial.ident.diagnosis import diagnose, evaluate_diagnosis
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import EstimationOptions, load_model
from seatrial.ident.model import ModelKind
from seatrial.ident.model import with_outlier_model as with_outliers
from seatrial.ident.models import effects_for
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import DiagnosisResult, diagnosis_result, estimation_warnings, provenance
from seatrial.ident.workflows.check import check_first, with_noise_floors
from seatrial.ident.workflows.model_inputs import check_ahead, in_one_frame, model_of_logs, unused_lines, unused_signals
from seatrial.ident.workflows.output import sensor_rates, validity, write_all
from seatrial.ident.workflows.vehicle_model import considered_notes


@dataclass(frozen=True)
class DiagnosisRequest:
    """A model to be diagnosed, as the options of the command say it.

    Attributes:
        model: the model.toml.
        logs, validation: logs that the search sees, and others that decide.
        out: folder for the results.
        estimation: its outlier model and its horizon count; the search compares maxima of the plain likelihood, by a
            filter of first order.
        max_effects: the search stops after so many.
        effects_file: candidates of the user's own.
        thruster: file of the static curve that a vehicle's model was fitted with; or which thruster, where the model
            is a thruster's and the logs have several.
        rate: rows a second to which faster sensors are averaged [Hz]; None: the model's usual ones.
        despite_faults: search also where the checks of the logs find what makes a fit meaningless.
        window: of the logs; those for validation are whole.
    """

    model: Path
    logs: Sequence[Path]
    validation: Sequence[Path]
    out: Path
    estimation: EstimationOptions = field(default_factory=EstimationOptions)
    max_effects: int = 3
    effects_file: Path | None = None
    thruster: str | None = None
    rate: float | None = None
    despite_faults: bool = False
    window: TimeWindow = WHOLE


def diagnosis(request: DiagnosisRequest, command: str, reporter: Reporter) -> DiagnosisResult:
    """Find what the model lacks, and write the model that has it; ``command``: what was typed."""
    loaded, unseen = load_all(request.logs, request.validation, request.window, device_faults)
    horizon, effects_file = request.estimation.horizon, request.effects_file
    saved = load_model(request.model)
    # Maxima of the plain likelihood are compared, by a filter of first order: neither changes what is found, and on
    # that the blind tests were made.
    plain = replace(saved.model, second_order=False)
    check_ahead(horizon, loaded, unseen)
    loaded, unseen = in_one_frame(plain, loaded, unseen, saved.origin)
    model, runs, others, usual = model_of_logs(plain, request.model, loaded, unseen, request.thruster)
    unused = unused_signals(model, loaded, unseen)
    told = unused_lines(unused) if model.kind is ModelKind.VEHICLE else []
    loaded, unseen = check_first(loaded, unseen, model, request.despite_faults)
    for line in told:
        reporter.warning(line)
    model, floors = with_noise_floors(model, loaded)
    own = effects_for(model, effects_file) if effects_file else {}
    found = diagnose(
        with_outliers(model) if request.estimation.outlier_model else model,
        runs,
        others,
        effects={**catalogue(), **own},
        rate=request.rate or usual,
        max_effects=request.max_effects,
        reporter=reporter,
    )
    result = diagnosis_result(
        found,
        evaluate_diagnosis(found, horizon),
        provenance([*loaded, *unseen], command),
        warnings=estimation_warnings(found.after.fit, found.after.records, loaded[0].vehicle.get("length")),
        notes=[*floors, *considered_notes(found.after.fit.model), *found.after.outlier_notes],
        model_path=str(request.model),
        unused=unused,
    )
    write_all(
        request.out, result, found.after.fit, validity(found.after), effects_file or saved.effects_file,
        rates=sensor_rates(found.after),
    )  # fmt: skip
    return result
