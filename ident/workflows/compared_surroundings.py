"""Surroundings of a comparison: models with the wind, or a similar effect, of other days than the compared logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta

from seatrial.ident.data import LoadedLog
from seatrial.ident.estimation import SavedModel
from seatrial.ident.model import Model
from seatrial.ident.results import NO_DATE, OTHER_SURROUNDINGS

OTHER_DAY = timedelta(hours=12)  # between the starts of logs, from which on the surroundings are other ones


def common_surroundings(model: Model) -> tuple[str, ...]:
    """Return the names of the effects of the surroundings of a model whose sizes are one for all logs.

    They act from outside the boat (`Effect.place`), as wind does. An effect whose first parameter, its size, has one
    value for each log is left out, because it is estimated anew on each log.
    """
    own = {p.name: p for p in model.parameters}
    return tuple(
        e.name
        for e in model.effects
        if e.place == "environment"
        and not e.kind.nuisance
        and e.parameters
        and (size := own.get(e.parameters[0].name)) is not None
        and not size.per_record
    )


def surroundings_notes(models: Mapping[str, SavedModel], logs: Sequence[LoadedLog]) -> list[str]:
    """Return the note on models whose surroundings are those of another day than a compared log; empty without any.

    A log is of another day if it begins more than 12 h before or after each log of the fit of a model. Logs without a
    date, and models that do not contain the starts of their logs, are not judged.

    Parameters
    ----------
    models : mapping
        Saved models by their labels in the comparison; "" is the label of the only model.
    logs : sequence of LoadedLog
        The compared logs.
    """
    starts = {log.run.name: t for log in logs if (t := _date(log.about.get("start"))) is not None}
    found, other = list[str](), dict[str, None]()
    for label, saved in models.items():
        effects = common_surroundings(saved.model)
        fitted = [t for text in saved.provenance.get("begins", ()) if (t := _date(text)) is not None]
        away = [name for name, t in starts.items() if all(abs(t - own) > OTHER_DAY for own in fitted)]
        if effects and fitted and away:
            found.append(f"({label}) {', '.join(effects)}" if label else ", ".join(effects))
            other |= dict.fromkeys(away)
    if not found:
        return []
    return [
        f"{OTHER_SURROUNDINGS}: {'; '.join(found)} with the values of the logs of the fit. The compared "
        f"logs {', '.join(other)} are of another day, and are predicted with these values. Compare models without "
        "them, or fit the logs of both days with a size of the effect for each log (--per-log; of the wind F_wx and "
        "F_wy), so that it is estimated anew on a compared log."
    ]


def _date(text: object) -> datetime | None:
    """Return a start time of a log, or None if it is unknown or has no date."""
    start = datetime.fromisoformat(text) if isinstance(text, str) and text else None
    return None if start is None or start.year <= NO_DATE else start
