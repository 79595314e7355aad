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
    """Attribution of a selected effect.

    Attributes:
        effect: its name.
        attribution: ``identified``: it explains what was missing, and no competing model does; ``ambiguous``: something
            is left that it should have explained, or a competing model comes close; ``nonparametric``: a curve without
            a name.
        reasons: why it is ambiguous, for people.
        rivals: names of the competing models that the data do not exclude, closest first.
    """

    effect: str
    attribution: Attribution
    reasons: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()


@dataclass(frozen=True)
class EffectImportance:
    """Importance of a selected effect.

    Attributes:
        effect: its name.
        gain: 2 d ln L on the estimation data, when it is added last.
        error: ratio of the prediction error three seconds ahead without it to that with it
            (``ident.diagnosis.importance``); geometric mean over the channels of the validation data, else of the
            estimation data.
    """

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
        """Whether all selected effects are identified."""
        return all(j.attribution == "identified" for j in self.judgements)
