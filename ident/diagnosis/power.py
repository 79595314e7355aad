"""Power of the score tests: the smallest size of each effect that the data of a diagnosis would have shown.

The statistic of a score test is noncentral chi-squared if the effect has a small size s. Its noncentrality is s² times
the information that the fitted parameters do not explain (Engle 1984). An effect is found if the statistic exceeds the
critical value of the test and the penalty of the BIC criterion. The size at which this happens with a probability of
80 % is computed for one parameter at a time, with the others at zero. The differences between the model and the boat
are left out, so that an effect of this size may still be found to be ambiguous.

The information is that of the fit without the effect. If the boat has the effect, the fitted disturbance forces explain
a part of it: they become larger or slower, which takes information. The sizes are therefore lower limits. An effect
that changes slowly, such as a constant moment, has to be up to twice as large (docs/detectable-sizes.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.score_test import Score, score_threshold
from seatrial.ident.model import EffectKind
from seatrial.ident.numerics import noncentrality

POWER = 0.8  # the usual power of a planned test
LARGEST = 100.0  # largest size in standard deviations of the parameter's prior; only rounding errors inform of others


@dataclass(frozen=True)
class DetectableSizes:
    """Smallest sizes of an effect that its score test finds with a probability of 80 %.

    Attributes
    ----------
    effect
        Name of the effect.
    sizes
        Smallest size of each parameter by its full name (``NAME@i`` in record i), in the unit of the parameter. A
        parameter that cannot be tested has no entry. Empty if the estimated parameters of the model explain the effect,
        so that no size can be found, and for ``waves``, whose test is that of a spectral peak.
    """

    effect: str
    sizes: dict[str, float]


def detectable_sizes(
    scores: Sequence[Score],
    n: int,
    policy: SearchPolicy = DEFAULT_POLICY,
    prior_sds: Mapping[str, float] | None = None,
) -> tuple[DetectableSizes, ...]:
    """Return the smallest size of each named effect that its score test finds with a probability of 80 %.

    Named effects are those of the catalogue and user-defined ones.

    Parameters
    ----------
    scores
        Scores of all candidates on one model. Nonparametric candidates and differences between runs are left out of the
        result.
    n
        Number of rows of the estimation data, for the penalty ``df ln n``.
    policy
        Thresholds of the score tests.
    prior_sds
        Standard deviation of the prior of each parameter by its name, in the unit of the parameter. A size of more than
        100 of them is left out: no boat has it, for example if a lever arm has no effect while its force is zero. Sizes
        of parameters that are missing here are not limited. None: no size is limited.

    Returns
    -------
    tuple of DetectableSizes
        One for each named effect, in the order of the scores. An effect whose score has no information is left out, and
        so is one whose sizes are all left out.
    """
    found, known = [], prior_sds or {}
    for score in scores:
        explained = score.tolerance < policy.min_tolerance
        if score.kind is not EffectKind.CATALOGUE or not (explained or score.information):
            continue  # the test of waves, for example, is one of a spectral peak and has no such information
        sizes: dict[str, float] = {}
        if not explained:
            limit = max(score_threshold(score, scores, policy), score.df * math.log(n))
            needed = noncentrality(limit, score.df, POWER)
            sizes = {name: math.sqrt(needed / info) for name, info in score.information.items() if info > 0}
            limits = {name: LARGEST * known.get(name.partition("@")[0], math.inf) for name in sizes}
            possible = {name: size for name, size in sizes.items() if size <= limits[name]}
            if sizes and not possible:
                continue
            sizes = possible
        found.append(DetectableSizes(score.name, sizes))
    return tuple(found)
