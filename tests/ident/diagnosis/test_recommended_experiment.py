"""Tests of the experiment that a diagnosis recommends: the command that designs it is only given if it can run."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from seatrial.ident.diagnosis.adequacy import competitors_of, reason_without_experiment, recommended_experiment
from seatrial.ident.diagnosis.findings import Diagnosis, EffectAttribution, Outcome, Refit, Round
from seatrial.ident.effects import catalogue, nonparametric_effect, separating_experiment
from seatrial.ident.model import Effect, EffectKind, ForceCurve
from seatrial.ident.models import horizontal_model, with_disturbances
from seatrial.ident.models.thruster import thruster_model
from seatrial.ident.results.diagnosis import diagnosis_caveat

OWN = replace(catalogue()["cubic-drag"], name="skeg-drag", title="drag of the skeg")  # of a file of the user


def ambiguous(effect: Effect, competitor: Effect) -> Diagnosis:
    """Return a diagnosis that has found an effect and cannot exclude a competitor."""
    refit = SimpleNamespace(effect=effect)
    found: Any = SimpleNamespace(
        before=SimpleNamespace(model=horizontal_model()),
        effects=(effect.name,),
        rounds=[SimpleNamespace(chosen=refit, refits=[refit])],
        remaining=[SimpleNamespace(name=competitor.name, kind=competitor.kind)],
        attributions=[EffectAttribution(effect.name, "ambiguous", (), (competitor.name,))],
    )
    return cast(Diagnosis, found)


@pytest.mark.parametrize(
    ("effect", "competitor", "has_command"),
    [
        (catalogue()["cubic-drag"], catalogue()["lift"], True),
        (OWN, catalogue()["lift"], False),
        (catalogue()["cubic-drag"], OWN, False),
    ],
)
def test_a_mission_is_recommended_only_for_effects_that_its_command_knows(
    effect: Effect, competitor: Effect, has_command: bool
) -> None:
    text = recommended_experiment(ambiguous(effect, competitor))
    assert text is not None
    assert text.startswith(f"To distinguish {effect.title} from {competitor.name}: {effect.experiment}.")
    command = f"`seatrial mission design MODEL --discriminate {effect.name},{competitor.name}` generates the mission; "
    assert (command in text) == has_command
    assert ("--discriminate" in text) == has_command


@pytest.mark.parametrize("names", [("wind", "steady-pull"), ("steady-pull", "wind")])
def test_no_mission_is_recommended_for_a_pair_that_none_distinguishes(names: tuple[str, str]) -> None:
    """The design of the recommended mission took four minutes, and even an hour of such missions was not enough."""
    effect, competitor = (catalogue()[name] for name in names)
    text = recommended_experiment(ambiguous(effect, competitor))
    assert text is not None
    assert text.startswith(f"To distinguish {effect.title} from {competitor.name}: measure the wind (an anemometer, ")
    assert text.endswith(" may not distinguish them, however long it is, because one can imitate the other.")
    assert "--discriminate" not in text
    left = [blank_score(name) for name in names]
    before, sure = SimpleNamespace(model=horizontal_model()), [judged("identified")]
    found = of(effects=("wind",), attributions=sure, remaining=left, before=before)
    assert "--discriminate" not in reason_without_experiment(found)
    found = of(effects=("wind",), attributions=sure, remaining=[*left, blank_score("lift")], before=before)
    assert f"--discriminate {names[0]},lift`" in reason_without_experiment(found)


def test_what_distinguishes_a_pair_is_stated_for_competing_effects_of_the_catalogue() -> None:
    pairs = [(effect, other) for effect in catalogue().values() for other in effect.separated_by]
    assert pairs
    for effect, other in pairs:
        assert other in effect.alternatives
        assert effect.name in catalogue()[other].alternatives
        assert separating_experiment(other, effect.name) == separating_experiment(effect.name, other) != ""
    assert separating_experiment("delay", "lag") == separating_experiment("wind", "ghost") == ""


def test_no_experiment_distinguishes_an_effect_from_its_special_case() -> None:
    mismatch, fouling = catalogue()["mismatch"], catalogue()["fouling"]
    for effect, other in ((mismatch, fouling), (fouling, mismatch)):
        assert (
            recommended_experiment(ambiguous(effect, other))
            == f"To test whether it is {effect.title}: {effect.experiment}."
        )


def test_the_experiment_is_for_the_pair_of_the_first_doubt() -> None:
    """The caveat doubts wind because of the lift, and the experiment was for another effect and its competitor."""
    known, curve = catalogue(), SimpleNamespace(name="X(u)", kind=EffectKind.NONPARAMETRIC)
    names, gains = ("cubic-drag", "wind", "filter-lag", "current-drift"), (300.0, 280.0, 100.0, 150.0)
    refits = [SimpleNamespace(effect=known[name], gain=gain) for name, gain in zip(names, gains, strict=True)]
    drag, wind = refits[:2]
    sure = EffectAttribution("cubic-drag", "identified", (), ("filter-lag",))
    doubted = EffectAttribution("wind", "ambiguous", ("tests find the lift",), ("current-drift",), "lift")
    rounds = [SimpleNamespace(chosen=refit, refits=refits) for refit in (drag, wind)]
    before = SimpleNamespace(model=horizontal_model(), records=[SimpleNamespace(duration=600.0)])
    effects = ("cubic-drag", "wind")
    left = [blank_score("lift"), curve]
    found = of(effects=effects, attributions=[sure, doubted], rounds=rounds, remaining=left, before=before)
    text = recommended_experiment(found)
    assert text is not None
    rival = known["current-drift"].title
    assert text.startswith(f"To distinguish {known['wind'].title} from {rival}: {known['wind'].experiment}.")
    assert f"To distinguish {known['wind'].title} from lift: {known['wind'].experiment}." in text
    first, second, third = (f"{pair}`" for pair in ("wind,current-drift", "wind,lift", "cubic-drag,filter-lag"))
    assert text.index(first) < text.index(second) < text.index(third)
    assert competitors_of(found, doubted) == ["current-drift", "lift"]
    # No mission distinguishes an effect from a curve, or from a special case of it.
    assert competitors_of(found, replace(doubted, competitor="X(u)")) == ["current-drift"]
    assert competitors_of(found, replace(doubted, competitor="mooring")) == ["current-drift"]  # not fitted


@pytest.mark.parametrize(
    ("behind", "named", "promised"),
    [
        (2.56, "", ""),  # 60 / 2.56 times nine minutes are 3.5 hours
        (2.56, "wind", " may decide this. "),
        (2.56, "X(u)", ""),
        (30.0, "", " may decide this."),
        (30.0, "X(u)", "distinguishes it from propeller walk, which the data do not exclude either."),
    ],
)
def test_a_mission_is_not_promised_to_decide_what_the_data_hardly_decide(
    behind: float, named: str, promised: str
) -> None:
    """Nine minutes of data: the design of the recommended mission found that an hour of missions is not enough."""
    angle, walk = catalogue()["thrust-angle"], catalogue()["propeller-walk"]
    refits = [SimpleNamespace(effect=angle, gain=244.5), SimpleNamespace(effect=walk, gain=244.5 - behind)]
    doubted = EffectAttribution("thrust-angle", "ambiguous", ("they are alike",), ("propeller-walk",), named)
    records = [SimpleNamespace(duration=300.0), SimpleNamespace(duration=240.0)]
    found = of(
        effects=(refits[0],), attributions=[doubted], rounds=[SimpleNamespace(chosen=refits[0], refits=refits)],
        remaining=[blank_score("wind")], before=SimpleNamespace(model=horizontal_model(), records=records),
        untried_scores=(),
    )  # fmt: skip
    text, caveat = recommended_experiment(found), diagnosis_caveat(found)
    assert text is not None
    assert caveat is not None
    begin = f"To distinguish {angle.title} from propeller walk:"
    command = "`seatrial mission design MODEL --discriminate thrust-angle,propeller-walk`"
    assert promised in caveat
    if behind < 10.0:
        assert text.startswith(
            f"{begin} look for {angle.causes}; or {walk.causes}. Both explain these 540 s of data nearly equally well "
            "(2 ln L differs by 2.6), so that a run of the same kind would have to last about 4 hours. They differ "
            f"most in these tests: {angle.experiment}; or {walk.experiment}. {command} only checks whether another "
        )
        assert "unlikely to distinguish it from propeller walk within an hour" in caveat
        assert bool(promised) == ("decide" in caveat)
    else:
        assert text.startswith(f"{begin} {angle.experiment}. {command} generates the mission; ")
        assert "unlikely" not in caveat
    assert ("--discriminate thrust-angle,wind`" in text) == (named == "wind")


def of(**changed: Any) -> Diagnosis:
    """Return a diagnosis for which no experiment is recommended."""
    quiet = dict.fromkeys(("effects", "rounds", "remaining", "attributions", "untested"), ())
    return cast(Diagnosis, SimpleNamespace(**quiet | {"short_data": None} | changed))


def judged(attribution: str) -> SimpleNamespace:
    return SimpleNamespace(effect="wind", attribution=attribution, not_excluded=(), competitor="")


def blank_score(name: str) -> SimpleNamespace:
    return SimpleNamespace(name=name, kind=catalogue()[name].kind)


@pytest.mark.parametrize(
    ("diagnosis", "reason"),
    [
        (of(), "no candidate passed the score tests, so that there is no effect to test"),
        (of(short_data=object()), "no candidate passed the score tests, and the data are too short"),
        (of(untested=[object()]), "could not be fitted"),
        (of(effects=("wind",), attributions=[judged("identified")]), "no competing effect is left"),
        (
            of(
                effects=("wind",),
                attributions=[judged("identified")],
                remaining=[blank_score("lift")],
                before=SimpleNamespace(model=horizontal_model()),
            ),
            "To test one, fit the model again with --effect lift, and compare both models on logs of neither fit",
        ),
    ],
)
def test_a_diagnosis_without_an_experiment_has_the_reason(diagnosis: Diagnosis, reason: str) -> None:
    assert recommended_experiment(diagnosis) is None
    assert reason in reason_without_experiment(diagnosis)


def test_candidates_beside_the_effects_get_the_command_that_tells_two_of_them_apart() -> None:
    left = [blank_score("lift"), blank_score("current-drift")]
    before = SimpleNamespace(model=horizontal_model())
    found = of(effects=("wind",), attributions=[judged("identified")], remaining=left, before=before)
    command = "`seatrial mission design MODEL --discriminate lift,current-drift` designs a mission that tells two apart"
    assert command in reason_without_experiment(found)
    curves = [SimpleNamespace(name="N(u, r)", kind=EffectKind.NONPARAMETRIC)]
    alone = of(effects=("wind",), attributions=[judged("identified")], remaining=curves)
    assert "record longer and more varied runs" in reason_without_experiment(alone)
    of_bench = of(
        effects=("stiction",), attributions=[judged("identified")], remaining=[blank_score("cell-lag")],
        before=SimpleNamespace(model=thruster_model()),
    )  # fmt: skip
    reason = reason_without_experiment(of_bench)
    assert reason.endswith("To test them, record longer and more varied tests on the bench, and diagnose again")
    assert "--effect" not in reason


@pytest.mark.parametrize(
    ("curve", "experiment"),
    [
        (("X", "u"), "X(u) stands for: runs that vary u slowly over its whole range, with all other variables"),
        (("N", "u", "r"), "N(u, r) stands for: runs that vary u and r slowly over their whole ranges, each at several"),
        (("X", "t"), "X(t) stands for: a run that repeats the same sequence of commands from its start to its end"),
    ],
)
def test_a_curve_has_an_experiment_that_covers_its_variable(curve: tuple[str, ...], experiment: str) -> None:
    effect = nonparametric_effect(with_disturbances(horizontal_model()), ForceCurve(*curve), (0.0, 1.0))
    refit = SimpleNamespace(effect=effect)
    of_curve = EffectAttribution(effect.name, "nonparametric")
    rounds = [SimpleNamespace(chosen=refit, refits=[refit])]
    text = recommended_experiment(of(effects=(effect.name,), attributions=[of_curve], rounds=rounds))
    assert text is not None
    assert text.startswith(f"To find what the curve {experiment}")


def test_an_experiment_of_two_rounds_is_recommended_once() -> None:
    """An effect explains most in two rounds, of which one adds another effect that is removed later."""
    lag, wind = (SimpleNamespace(effect=catalogue()[name]) for name in ("filter-lag", "wind"))
    rounds = [SimpleNamespace(chosen=None, refits=[refit], nearest=()) for refit in (lag, lag, wind)]
    text = recommended_experiment(of(rounds=rounds))
    assert text is not None
    for effect in (lag.effect, wind.effect):
        begin = f"To test whether {effect.title} is present, which explains most of the estimation data and was not"
        assert text.count(f"{begin} added: {effect.experiment}.") == 1


def test_the_experiment_is_for_the_effect_that_comes_nearest() -> None:
    """The answer named a sloshing mass and a line, and the experiment was for a steady force, "which came closest".

    The refits are those of a 128 kg catamaran, in the order of the criterion of the estimation data.
    """
    gaining = (
        ("steady-pull", 2, 29.2, 8.7, 0.85),
        ("battery-sag", 1, 18.4, -1.2, -0.23),
        ("sway-slosh", 3, 18.1, 9.7, 1.49),
        ("mooring", 4, 11.4, 8.7, 0.87),
        ("wind", 6, 0.07, 11.0, 1.09),
    )
    fits: Any = SimpleNamespace()
    refits = tuple(
        Refit(catalogue()[name], fits, criterion + 9.43 * df, df, criterion, gain, t, outcome=Outcome.NOT_VALIDATED)
        for name, df, criterion, gain, t in gaining
    )
    search_round = Round((), (), refits, None)
    assert [r.effect.name for r in search_round.nearest] == ["sway-slosh", "wind", "mooring", "steady-pull"]
    effect = catalogue()["sway-slosh"]
    assert recommended_experiment(of(rounds=[search_round])) == (
        f"To test whether {effect.title} is present, which comes nearest and was not added: {effect.experiment}."
    )
