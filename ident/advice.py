"""After a diagnosis: which experiment would settle what is still open."""

from __future__ import annotations

from ident.findings import Diagnosis


def next_experiment(diagnosis: Diagnosis) -> str | None:
    """What would settle what is still open; ``MODEL`` in a command stands for the model that was diagnosed.

    For an effect with rivals that the data do not exclude: the experiment that shows it, and the command that designs
    the mission to tell the two apart. For one that only resembles what is missing: its experiment. Where the tests
    passed but nothing held on the validation data: the experiment of the likeliest.
    """
    lines = []
    by_name = {j.effect: j for j in diagnosis.judgements}
    for one in diagnosis.rounds:
        if one.chosen is None:
            if not diagnosis.effects and one.refits and one.refits[0].effect.experiment:
                e = one.refits[0].effect
                lines.append(f"To see whether {e.title} is there at all: {e.experiment}.")
            continue
        effect, judged = one.chosen.effect, by_name.get(one.chosen.effect.name)
        titles = {q.effect.name: q.effect.title for q in one.refits}
        rivals = [r for r in judged.rivals if r in titles] if judged is not None else []
        for rival in rivals[:1]:
            lines.append(f"To tell {effect.title} from {titles[rival]}: {effect.experiment}.")
            if "hull" in diagnosis.before.model.provides and not one.chosen.unknown:
                lines.append(f"`seatrial mission design MODEL --between {effect.name},{rival}` makes the mission.")
        if judged is not None and judged.certainty == "resembles" and not rivals:
            lines.append(f"To see whether it is {effect.title}: {effect.experiment}.")
    return " ".join(lines) or None
