"""Thresholds of a diagnosis: score tests, search, acceptance, attribution and reported mismatches."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchPolicy:
    """Thresholds with which a diagnosis searches, accepts, removes and attributes effects.

    A *block* is the block of time of the model: 5 s for a boat, 2 s for a thruster on the bench. A *criterion* is a
    gain in 2 ln L less the penalty ``df ln n`` of the added parameters (Delta BIC, no unit). An *error ratio* is the
    ratio of two RMS prediction errors (no unit). *By inputs alone* means with the disturbance forces set to zero.

    Attributes
    ----------
    false_alarm_probability
        Probability that any score test of one model passes without a missing effect. One half is for the parametric
        candidates and one half for the nonparametric ones. 5 % is the usual level; the validation data decide later.
    block_level
        Significance level of the block-robust p value of a score test. It is a second condition beside the critical
        value of the statistic, and the usual 1 %.
    overwhelming_p, overwhelming_block_level
        A score test whose p value is below ``overwhelming_p`` passes if its block-robust p value is below
        ``overwhelming_block_level``. Few blocks limit the block-robust statistic even for a large effect. The
        validation data decide later.
    max_peak_p
        Largest p value, times the number of peaks, of a spectral peak of the innovations that is tested as waves.
        Coloured innovations without waves have larger p values (tests/ident/numerics/test_spectral_peak.py).
    max_wave_sample_interval
        Longest sample interval [s] of a channel that is searched for waves. Slower channels do not resolve waves.
    n_refits
        Number of parametric candidates in one batch of refits. Each refit is a complete fit, so the number limits the
        computing time.
    n_batches
        Largest number of batches in a round. The next batch is fitted only if no refit of the earlier batches is
        accepted.
    n_nonparametric
        Largest number of nonparametric candidates that are refitted in a round, also to limit the computing time.
    min_score_ratio
        A parametric candidate is refitted only if the criterion of its score exceeds this share of the largest one. A
        refit can gain up to ten times as much as its score test predicts, but not twenty times.
    max_refit_growth
        Largest criterion of a refit over that of its score. A candidate that cannot win even so, after the best two of
        its batch were refitted, is not refitted. On the boats of docs/real-boats.md the largest is 3.4.
    nonparametric_score_share, nonparametric_score_distance
        A nonparametric candidate is refitted if the criterion of its score exceeds two limits: the share of the largest
        criterion of the accepted parametric refits, and that criterion less the distance. Without such a refit there is
        no limit. A curve without a formula has to explain about as much as the best formula. The limits do not hold for
        the curve of which the best accepted parametric effect is one form.
    min_common_errors
        The common errors of every craft (sensor timing, mounting, hull form) are added together only if at least so
        many of them are needed at once. Fewer are found one by one, each as an effect of its own.
    min_error_ratio_beside
        Value that replaces ``min_error_ratio`` and ``material_error_ratio`` if the model has the common errors. What
        then remains of a real boat is the difference between its hull and any formula. It resembles small effects,
        which change the prediction by a few per cent.
    max_loss
        Largest loss in 2 ln L that a larger model may have against the model that it contains; such a loss is a
        rounding of the search. A larger loss means that the search stopped early, and other initial values are tried.
    indistinguishable
        Two criteria that differ by less than this are equal, and the prediction errors decide. A difference below 2 in
        BIC is "not worth more than a bare mention" (Kass and Raftery 1995).
    min_gain_ratio
        Smallest criterion of an added effect as a share of the largest criterion of the effects added before. The
        difference between the true form of an effect and that of the catalogue resembles other, much smaller effects.
    max_small_error_ratio
        An effect below ``min_gain_ratio`` is still added if the prediction errors with it are significantly smaller,
        and their ratio to those without it is below this value.
    min_gain_ratio_after_curve
        Smallest criterion of the score of a parametric candidate after a nonparametric curve was added, as a share of
        the largest criterion of the effects added before. The difference between a true curve and its spline gains up
        to a fifteenth of the curve. Most other missing effects gain a third or more.
    min_t
        The t statistic of the gain on the validation data has to exceed this value. An effect that does not exist
        exceeds two standard errors with a probability of 2.3 %.
    min_pooled_t, min_t_if_pooled
        A t statistic of the validation data above ``min_t_if_pooled`` is enough if the t statistic over the blocks of
        all data exceeds ``min_pooled_t``. An effect that does not exist exceeds the latter ten times less often than
        ``min_t``. The rule is for gains in bursts, such as in turns, of which the validation data have few.
    min_trial_criterion
        If no effect was accepted in a round, a refit whose gain on the validation data is positive but not significant
        is tried together with a second effect. Its criterion has to exceed this value. So does that of a candidate
        that is to take the place of a removed effect.
    min_t_if_predicting
        Replaces ``min_t`` in the backward elimination for an effect that improves the prediction, which is further
        evidence.
    max_ratio_without_t
        Error ratio over the horizon, with the effect over without it. If its whole 95 % interval is below this value,
        the backward elimination asks for a positive gain on the validation data, and for no t statistic.
    min_identified_ratio, min_identified_ratio_beside
        Error ratio, without the effect over with it, below which an effect is not identified. The second value replaces
        the first one if the model has the common errors, and always for an effect of the form of the hull. A real boat
        has many small imperfections, and an effect of the catalogue resembles several of them: on ten boats of other
        authorship, names of effects that changed the prediction by less than 15 % were wrong in two of four cases.
    min_error_ratio
        Error ratio, without the effect over with it, above which a change of the prediction without a significant
        interval counts as an improvement. In the recovery study one of 153 correct effects and all wrong effects are
        below 1.011.
    material_error_ratio
        Error ratio, without the effect over with it, up to which the prediction is as good without the effect.
    input_horizon
        Horizon, in blocks, of the prediction by inputs alone: 0.6 blocks are 3 s for a boat and 1.2 s on the bench. In
        about that time the speed follows the thrust.
    min_double_blocks
        If the validation data have fewer blocks of double length than this, the gain is summed over single blocks. A
        t statistic over a few blocks has too few degrees of freedom.
    min_mismatch
        A validation run is reported if the lower end of the 95 % interval of the ratio of actual to claimed one-step
        errors (no unit) exceeds this value. Smaller excesses are in the calibration table of the report.
    min_estimation_blocks
        Number of blocks of estimation data below which no effect is identified (100 s for a boat).
    min_validation_blocks
        Number of blocks of validation data below which no effect is identified (40 s for a boat). Two of these blocks
        are one block of the gain; with fewer, t > 2 is often chance.
    max_remaining_criterion, max_remaining_share
        Largest criterion of a score test that may still pass beside an identified effect: the larger of an absolute
        value and a share of the sum of the criteria of all added effects, but (above the absolute value) not more than
        the criterion of the effect itself. The true form of an effect is not exactly that of the catalogue
        (tests/recovery: leave-one-out against the full catalogue).
    max_remaining_tests, max_remaining_test_share
        Largest number of score tests that may still pass beside an identified effect: the larger of an absolute number
        and a share of all tests. A small difference of form makes a few of them pass, and the more, the more
        candidates there are.
    n_beside, max_change_beside
        If score tests still pass, the last model is fitted together with the ``n_beside`` strongest remaining
        candidates, and with up to as many remaining alternatives of the effects found. If the strongest parameter of an
        effect changes by less than the share ``max_change_beside`` of its value, the effect exists beside them, and the
        remaining tests are no reason against it.
    min_ratio_beside_many
        If more score tests pass than ``max_remaining_tests`` and ``max_remaining_test_share`` allow, an effect that
        keeps its size beside the strongest candidates is identified only if the error without it over that with it is
        at least this value, and t on the validation data exceeds ``min_t``. On realistic mock boats two of the three
        effects that fail this had the wrong name, and none of the seven others (docs/realistic-boats.md).
    max_curve_share
        A nonparametric curve that was added beside an effect is no reason against the effect if the effect keeps its
        size and the criterion of the curve is below this share of that of the effect.
    max_distance, max_distance_share
        A competing model is not excluded if its criterion is lower than that of the chosen effect by less than the
        larger of an absolute value and a share of the criterion of the chosen effect.
    min_significance
        Smallest distance of an identified effect from zero, in standard errors. Right effects exceed it even at half
        their size.
    position_reach
        The position of an effect (such as the fixed end of a line) is undetermined if its distance from the boat is not
        larger than this number of standard errors.
    max_position_distance
        A position on the boat that differs by more than this number of standard deviations from the usual one is a
        reason for ambiguity. The standard deviation is that of the difference.
    min_tolerance
        Smallest share of the information of a score that the estimated parameters do not explain (its tolerance). Below
        it, they explain the effect. If the thrust is estimated, its asymmetry explains a loss in reverse except 0.005
        to 0.04 %. Other effects keep 0.3 % and more (tests/recovery).
    form_share
        An effect whose criterion is below this share of that of a declared alternative may only correct the form of
        that alternative.
    """

    false_alarm_probability: float = 0.05
    block_level: float = 0.01
    overwhelming_p: float = 1e-12
    overwhelming_block_level: float = 0.1
    max_peak_p: float = 1e-6
    max_wave_sample_interval: float = 0.25

    n_refits: int = 4
    n_batches: int = 2
    n_nonparametric: int = 2
    min_score_ratio: float = 0.05
    max_refit_growth: float = 5.0
    nonparametric_score_share: float = 0.5
    nonparametric_score_distance: float = 50.0
    min_common_errors: int = 4
    min_error_ratio_beside: float = 1.1
    min_identified_ratio: float = 1.0
    min_identified_ratio_beside: float = 1.15
    max_loss: float = 1.0
    indistinguishable: float = 2.0
    min_gain_ratio: float = 0.02
    max_small_error_ratio: float = 0.98
    min_gain_ratio_after_curve: float = 0.1

    min_t: float = 2.0
    min_pooled_t: float = 3.0
    min_t_if_pooled: float = 1.0
    min_trial_criterion: float = 50.0
    min_t_if_predicting: float = 1.0
    max_ratio_without_t: float = 0.8
    min_error_ratio: float = 1.015
    material_error_ratio: float = 1.005
    input_horizon: float = 0.6
    min_double_blocks: int = 12
    min_mismatch: float = 1.3

    min_estimation_blocks: int = 20
    min_validation_blocks: int = 8
    max_remaining_criterion: float = 20.0
    max_remaining_share: float = 0.03
    max_remaining_tests: int = 8
    max_remaining_test_share: float = 0.1
    n_beside: int = 3
    max_change_beside: float = 0.3
    min_ratio_beside_many: float = 1.2
    max_curve_share: float = 0.3
    max_distance: float = 10.0
    max_distance_share: float = 0.05
    min_significance: float = 4.0
    position_reach: float = 3.0
    max_position_distance: float = 2.0
    min_tolerance: float = 1e-3
    form_share: float = 0.1


DEFAULT_POLICY = SearchPolicy()
