"""Results of a diagnosis: rounds of the search, refits, attribution and importance of the selected effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ident.diagnosis.score_test import Score
from ident.effects import NonparametricForce
from ident.estimation import FittedModel
from ident.model import Effect

T_VALIDATION = 2.0
Attribution = Literal["identified", "ambiguous", "nonparametric"]


@dataclass(frozen=True)
class Refit:
    """The model of a round with one more effect, everything fitted again.

    gain: 2 d ln L (with priors); df: parameters added; criterion: gain - df ln n; validation_gain: d ln L on the
    validation data, and t its statistic over blocks.
    """

    effect: Effect
    stage: FittedModel
    gain: float
    df: int
    criterion: float
    validation_gain: float
    t: float

    @property
    def accepted(self) -> bool:
        return self.criterion > 0 and self.t > T_VALIDATION

    @property
    def unknown(self) -> bool:
        """Not an effect of the catalogue."""
        return self.effect.kind.unknown


@dataclass(frozen=True)
class Round:
    scores: tuple[Score, ...]
    passed: tuple[str, ...]
    refits: tuple[Refit, ...]
    chosen: Refit | None
    why: str


@dataclass(frozen=True)
class EffectAttribution:
    """How sure the name of an added effect is.

    identified: it explains what was missing, and nothing else does. ambiguous: it explains much of it, but something is
    left that it should have explained, or another explains it about as well (``reasons``, for people). ``rivals``:
    names that the data do not exclude, closest first. nonparametric: no name, a table.
    """

    effect: str
    attribution: Attribution
    reasons: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()


@dataclass(frozen=True)
class EffectImportance:
    """effect: its name; gain: 2 d ln L on the estimation data that it brings when it comes last; error: what the
    inputs alone predict three seconds ahead (``ident.diagnosis.importance``) is off by without it, over that with it;
    the geometric
    mean over the channels of the validation data, of the estimation data where there are none."""

    effect: str
    gain: float
    error: float


@dataclass(frozen=True)
class Diagnosis:
    """before, after: the model without and with the effects; left: what still passes the tests at the end, best
    first; shapes: the curves of nonparametric effects, and of the first ambiguous one; weights and judgements: one for
    each effect, the most important first."""

    before: FittedModel
    after: FittedModel
    rounds: tuple[Round, ...]
    left: tuple[Score, ...]
    shapes: tuple[NonparametricForce, ...]
    judgements: tuple[EffectAttribution, ...] = ()
    weights: tuple[EffectImportance, ...] = ()

    @property
    def effects(self) -> tuple[Refit, ...]:
        """Refits of the selected effects, the most important first."""
        chosen = {r.chosen.effect.name: r.chosen for r in self.rounds if r.chosen is not None}
        return tuple(chosen[w.effect] for w in self.weights)

    @property
    def sure(self) -> bool:
        """Every effect that was added is named without doubt."""
        return all(j.attribution == "identified" for j in self.judgements)
