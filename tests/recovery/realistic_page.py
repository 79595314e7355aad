"""Page of the diagnoses of realistic mock boats: docs/realistic-boats.md, from the lines of the recovery study.

python -m tests.recovery.study --kinds realistic,realistic-double --seeds 1 --seed 41 \
    --out docs/data/realistic-boats.jsonl
python -m tests.recovery.study --kinds realistic-clean --seeds 60 --seed 101 --out docs/data/realistic-boats.jsonl
python -m tests.recovery.realistic_page
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from seatrial.ident.diagnosis.certainty import NAME_RECORDS
from seatrial.mocks.hidden_effects.catalogue import make_effect
from tests.recovery import prior_study
from tests.recovery.cases import Row
from tests.recovery.kinds import KINDS, all_large
from tests.recovery.next_experiment import BEFORE, DESIGNED, MIXED
from tests.recovery.resumable import read
from tests.recovery.tables import as_markdown, interval
from tests.recovery.verdict import answers, present

ROOT = Path(__file__).parents[2]
DATA = ROOT / "docs/data/realistic-boats.jsonl"
MISSIONS = ROOT / "docs/data/next-experiment.jsonl"
PAGE = ROOT / "docs/realistic-boats.md"
MASSES = ("m_u", "m_v", "m_r")
MATTERS = 1.3  # error of the model without the effect over that with it, from which an effect matters
SIZES = {"realistic": "full", "realistic-double": "double"}
TEXT = """# What a diagnosis sees on realistic mock boats

Each mock boat has the small imperfections of real boats: fixes that are late, a compass behind a heading filter, late
and rounded telemetry, a skeg, steady wind, gusts, waves, a battery that sags, thrusters of unequal strength. One effect
of full or of double size is added, which no file declares. Two missions of 400 and 250 s are recorded as logs, and
`seatrial ident vehicle` and `seatrial ident diagnose` run on them as a user would run them, with the thrust known to
5 %.

    python -m tests.recovery.study --kinds realistic,realistic-double --seeds 1 --seed {seed} \\
        --out docs/data/realistic-boats.jsonl
    python -m tests.recovery.study --kinds realistic-clean --seeds 60 --seed 101 \\
        --out docs/data/realistic-boats.jsonl
    python -m tests.recovery.realistic_page

On boat {seed}, {n_run} of the {n_all} effects were run, with `--effects`: those that were expected to change the motion
most. The other boats have other imperfections, and an effect each that was drawn at random (`--seeds 1 --seed BOAT`).
So the shares below are not those of all effects. A study of all rows takes more than an hour: they are of {n_codes}
states of the code (`code` in the data), and single rows can differ from what the present one says.
The CPU seconds are those of different machines, some of them half as fast as others.

The column *matters* is known only to the study: the error ten seconds ahead of a model with everything but this effect,
over that of the model with it. The smaller the ratio, the less a trial of this length can show.

{table}

The true effect is identified on {identified} of {n} boats, found but ambiguous on {ambiguous}, and not found on
{missed}. {n_large} of the effects raise the error by {matters:.0f} % or more; {large} of these are identified (95 %
interval {large_interval}), and {large_found} are found. {held} of {kept} masses and inertias are within three standard
errors.

On {n_clean} boats with the small imperfections alone, {n_clean_found} effects are called identified ({clean_found}), of
which {clean_wrong} are not in the boat (95 % interval of such boats: {clean_interval} %). {clean_likened} boats are
told of an ambiguous effect that they do not have.

## How certain a name is

The diagnosis calls an effect identified or ambiguous. The table counts how often the effect was in the boat, over all
boats of this page. Wind, a difference of the thrusters, waves and a dead band are in every one of these boats.

{certainty}

{n_wind} of the identified names are wind, which is in every boat. Of the {n_other} others, {other_right} are right.

seatrial states a probability with each name. It is the share of right names on these boats and on the
[boats of other authorship](real-boats.md) together, by the rule of succession: {stated}.

An effect that is *identified* explains what was missing, and no competing model does. *Ambiguous* means that the data
do not distinguish several effects, or that the prediction is no better with it.

## What one more mission adds

{further}

## Warnings about correct priors

`seatrial ident vehicle` warns if the data contradict a prior (`prior-contradicted`). A correct prior is a measurement
with an error of the stated size. The table counts the warnings about such priors: of the thrust, three masses and three
coefficients of damping, on textbook boats (*clean*), on boats of this page without a large effect, and on such boats
with a large effect that the model lacks.

    python -m tests.recovery.prior_study

{priors}

The warning is given if data and prior differ by more than three of their common standard deviations, which include the
uncertainty of the model. The last column is the root mean square of this distance; 1 is expected.
"""

FURTHER = """\
For an ambiguous answer the report recommends `seatrial mission design --discriminate A,B`, which takes the
fitted sizes of both effects. {n_missions} boats ran such a mission of 250 s, and for comparison a mixed mission
of the same length, as a further log of the fit and of the diagnosis. The first of the two effects is in the
boat in all cases. The table has its attribution and the probability that seatrial states for it, and in
parentheses the probability that was expected before the mission.

    python -m tests.recovery.next_experiment --out docs/data/next-experiment.jsonl

{missions}

The probability of the right name was {before:.0f} % on average before the mission. Expected and stated after it are
{expected_design:.0f} % and {by_design:.0f} % for the designed mission, {expected_mixed:.0f} % and {by_mixed:.0f} % for
the mixed one. The name is identified in {sure_design} of {n_missions} cases after the designed mission, and in
{sure_mixed} after the mixed one.

The expectation takes the criterion T of the mission (twice the expected log-likelihood ratio, at least
{least_T:.0f} for the designed missions and {least_T_mixed:.0f} for the mixed ones) and the lead of the first
effect in the diagnosis. It assumes that one of the two models describes the boat completely. These boats differ
from both by their small imperfections, so that a name can stay ambiguous although T is large. {n_missions}
cases are too few to compare the two missions."""
# The same for lines of an earlier version, which have no expected probability.
EARLIER = """\
For an ambiguous answer the report recommends `seatrial mission design --discriminate A,B`. {n_missions} boats
ran such a mission of 250 s, and for comparison a mixed mission of the same length, as a further log of the fit
and of the diagnosis. The table has the attribution of the first of the two effects, which is in the boat in all
cases.

    python -m tests.recovery.next_experiment --out docs/data/next-experiment.jsonl

{missions}

The designed mission makes the name certain in {sure_design} of {n_missions} cases, the mixed mission in
{sure_mixed}. So a further log helps, and {n_missions} cases do not show that its design helps more. In these
cases the design took the fitted size of the first effect and a typical size of the second one. It has taken the
fitted sizes of both since then."""


def main() -> int:
    """Write the page from the lines of the study."""
    rows = [r for r in read(DATA).values() if "error" not in r]
    PAGE.write_text(document(rows), encoding="utf-8")
    print(f"written: {PAGE.name}")
    return 0


def document(rows: Sequence[Row]) -> str:
    """Return the text of the page."""
    clean, rows = [r for r in rows if r["kind"] == "realistic-clean"], [r for r in rows if r["kind"] in SIZES]
    sure = [(r, name) for r in clean for name, how in pairs(r) if how == "identified"]
    others = [n in present(r) for r in [*rows, *clean] for n, how in pairs(r) if how == "identified" and n != "wind"]
    ways = [attribution_of(r) for r in rows]
    large = [r for r in rows if (r.get("dominance") or 0.0) >= MATTERS]
    large_sure = sum(attribution_of(r) == "identified" for r in large)
    z = [r["z"][name] for r in rows for name in MASSES if name in r["z"]]
    (seed, _), *_ = Counter(r["seed"] for r in rows).most_common()
    return TEXT.format(
        seed=seed,
        n_run=len({r["effect"] for r in rows if r["seed"] == seed}),
        table=as_markdown(table(rows)),
        further=further(mission_rows()),
        priors=as_markdown(prior_study.table([r for r in read(prior_study.OUT).values() if "error" not in r])),
        stated=" and ".join(f"{100 * r.probability:.0f} % {how}" for how, r in NAME_RECORDS.items()),
        certainty=as_markdown(certainty([*rows, *clean])),
        n=len(rows),
        n_all=len(all_large(0)),
        n_codes=len({r.get("code") for r in [*rows, *clean]}),
        identified=ways.count("identified"),
        ambiguous=ways.count("ambiguous"),
        missed=ways.count(""),
        n_large=len(large),
        large=large_sure,
        large_interval=interval(large_sure, len(large)),
        large_found=sum(attribution_of(r) != "" for r in large),
        matters=100 * (MATTERS - 1.0),
        n_clean=len(clean),
        n_clean_found=len(sure),
        clean_found=", ".join(sorted({name for _, name in sure})) or "none",
        clean_wrong=sum(name not in present(r) for r, name in sure),
        clean_interval=interval(len({r["key"] for r, name in sure if name not in present(r)}), len(clean)),
        clean_likened=sum(any(how != "identified" and n not in present(r) for n, how in pairs(r)) for r in clean),
        n_wind=sum(named == ("wind", "identified") for r in [*rows, *clean] for named in pairs(r)),
        n_other=len(others),
        other_right=sum(others),
        held=sum(abs(v) <= 3.0 for v in z),
        kept=len(z),
    )


def further(rows: Sequence[Row]) -> str:
    """Return the text about the further missions, with their table."""
    counts = {
        f"sure_{word}": sum(name_of(r, when)[0] == "identified" for r in rows)
        for word, when in (("design", DESIGNED), ("mixed", MIXED))
    }
    text = {"n_missions": len(rows), "missions": as_markdown(missions(rows))} | counts
    if not all("expected" in r for r in rows):
        return EARLIER.format(**text)
    stated = {when: 100 * float(np.mean([name_of(r, when)[1] for r in rows])) for when in (BEFORE, DESIGNED, MIXED)}
    expected = {when: 100 * float(np.mean([r["expected"][when] for r in rows])) for when in (DESIGNED, MIXED)}
    return FURTHER.format(
        **text,
        before=stated[BEFORE],
        by_design=stated[DESIGNED],
        by_mixed=stated[MIXED],
        expected_design=expected[DESIGNED],
        expected_mixed=expected[MIXED],
        least_T=min(r["T"][DESIGNED] for r in rows),
        least_T_mixed=min(r["T"][MIXED] for r in rows),
    )


def missions(rows: Sequence[Row]) -> list[list[str]]:
    """Return the table of the missions that tell two effects apart: attribution of the first before and after.

    With an expected probability, the table also has the probabilities and the origin of the sizes of the design.
    """
    head = ["boat", "effects to tell apart", "before", "with the designed mission", "with a mixed mission"]
    lines = [head]
    for row in rows:
        kind, effect, _ = row["key"].split("/")
        names, cells = " and ".join(row["pair"]), []
        if "sizes" in row:
            names = " and ".join(f"{name} ({row['sizes'][name]})" for name in row["pair"])
        for when in (BEFORE, DESIGNED, MIXED):
            how, probability = name_of(row, when)
            words = f"{how}, {100 * probability:.0f} %" if "expected" in row else how
            known = "expected" in row and when != BEFORE
            cells.append(words + (f" (expected {100 * row['expected'][when]:.0f} %)" if known else ""))
        lines.append([f"{effect}, {SIZES[kind]} size", names, *cells])
    return lines


def mission_rows() -> list[Row]:
    """Return the lines of the further missions; without those of a boat whose first diagnosis was not ambiguous."""
    return [row for row in read(MISSIONS).values() if row["pair"]]


def name_of(row: Row, when: str) -> tuple[str, float]:
    """Return attribution and stated probability of the first of the two effects; "not found" and 0 without it."""
    found = row["diagnoses"][when]
    for name, how in zip(found["found"], found["attribution"], strict=True):
        if name == row["pair"][0]:
            return how, NAME_RECORDS[how].probability
    return "not found", 0.0


def certainty(rows: Sequence[Row]) -> list[list[str]]:
    """Return the table of the attributions: how many effects got each, and how many of them are in the boat."""
    lines = [["attribution", "effects", "in the boat", "share", "95 % interval"]]
    for how in ("identified", "ambiguous"):
        named = [name in present(r) for r in rows for name, found in pairs(r) if found == how]
        share = f"{100 * sum(named) / len(named):.0f} %" if named else ""
        lines.append([how, str(len(named)), str(sum(named)), share, interval(sum(named), len(named)) if named else ""])
    return lines


def table(rows: Sequence[Row]) -> list[list[str]]:
    """Return the table of all boats: effect, size, importance, answer, error, masses, processor time."""
    lines = [
        ["effect", "boat", "size", "true value", "matters", "answer", "10 s error, after / before", *MASSES, "CPU s"]
    ]
    for r in sorted(rows, key=lambda r: -(r.get("dominance") or 0.0)):
        size = make_effect(r["effect"], r["seed"], KINDS[r["kind"]].scale).parameters
        shown = ", ".join(f"{n} = {v:.3g}" for n, v in list(size.items())[:2])
        found = ", ".join(f"{n} ({how})" for n, how in pairs(r)) or "nothing"
        before, after = r["before"]["horizon"], r["after"]["horizon"]
        change = float(np.exp(np.mean([np.log(after[n] / before[n]) for n in before])))
        matters = "" if r.get("dominance") is None else f"{r['dominance']:.2f}"
        z = [f"{r['z'][n]:+.1f} s.e." if n in r["z"] else "" for n in MASSES]
        error, cpu = f"{change:.2f}" if r["found"] else "", f"{r['cpu']:.0f}"
        lines.append([r["effect"], str(r["seed"]), SIZES[r["kind"]], shown, matters, found, error, *z, cpu])
    return lines


def pairs(row: Row) -> list[tuple[str, str]]:
    """Return name and attribution of the effects that the diagnosis has found."""
    return list(zip(row["found"], row["attribution"], strict=True))


def attribution_of(row: Row) -> str:
    """Return the attribution of the true effect; empty if it was not found."""
    return next((how for name, how in pairs(row) if name in answers(row)), "")


if __name__ == "__main__":
    sys.exit(main())
