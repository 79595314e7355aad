"""Page of the diagnoses of realistic mock boats: docs/realistic-boats.md, from the lines of the recovery study.

python -m tests.recovery.study --kinds realistic,realistic-double --seeds 1 --seed 41 \
    --out docs/data/realistic-boats.jsonl
python -m tests.recovery.study --kinds realistic-clean --seeds 4 --seed 41 --out docs/data/realistic-boats.jsonl
python -m tests.recovery.realistic_page
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from seatrial.ident.diagnosis.certainty import NAME_RECORDS
from seatrial.mocks.hidden_effects.catalogue import make_effect
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
    python -m tests.recovery.study --kinds realistic-clean --seeds 4 --seed {seed} \\
        --out docs/data/realistic-boats.jsonl
    python -m tests.recovery.realistic_page

On boat {seed}, 20 of the {n_all} effects were run, with `--effects`: those that were expected to change the motion
most. The other boats have other imperfections, and an effect each that was drawn at random (`--seeds 1 --seed BOAT`).
So the shares below are not those of all effects.

The column *matters* is known only to the study: the error ten seconds ahead of a model with everything but this effect,
over that of the model with it. The smaller the ratio, the less a trial of this length can show.

{table}

The true effect is identified on {identified} of {n} boats, found but ambiguous on {ambiguous}, and not found on
{missed}. {n_large} of the effects raise the error by {matters:.0f} % or more; {large} of these are identified (95 %
interval {large_interval}), and {large_found} are found. {held} of {kept} masses and inertias are within three standard
errors.

On {n_clean} boats with the small imperfections alone, {n_clean_found} effects are called identified ({clean_found}), of
which {clean_wrong} are not in the boat.

## How certain a name is

The diagnosis calls an effect identified or ambiguous. The table counts how often the effect was in the boat, over all
boats of this page. Wind, a difference of the thrusters, waves and a dead band are in every one of these boats.

{certainty}

seatrial states these shares with each name, by the rule of succession: {stated}. The
[boats of other authorship](real-boats.md) test them.

An effect that is *identified* explains what was missing, and no competing model does. *Ambiguous* means that the data
do not distinguish several effects, or that the prediction is no better with it.

## What one more mission adds

For an ambiguous answer the report recommends `seatrial mission design --discriminate A,B`. Five boats ran such a
mission of 250 s, and for comparison a mixed mission of the same length, as a further log of the fit and of the
diagnosis. The table has the attribution of the first of the two effects, which is in the boat in all five cases.

    python -m tests.recovery.next_experiment --out docs/data/next-experiment.jsonl

{missions}

The designed mission makes the name certain in {by_design} of {n_missions} cases, the mixed mission in {by_mixed}. So a
further log helps, and five cases do not show that its design helps more. The mission is designed with typical sizes of
the two effects, not with those of the boat.
"""


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
    ways = [attribution_of(r) for r in rows]
    large = [r for r in rows if (r.get("dominance") or 0.0) >= MATTERS]
    large_sure = sum(attribution_of(r) == "identified" for r in large)
    z = [r["z"][name] for r in rows for name in MASSES if name in r["z"]]
    return TEXT.format(
        seed=rows[0]["seed"],
        table=as_markdown(table(rows)),
        missions=as_markdown(missions()),
        by_design=sum(line[3] == "identified" for line in missions()[1:]),
        by_mixed=sum(line[4] == "identified" for line in missions()[1:]),
        n_missions=len(missions()) - 1,
        stated=" and ".join(f"{100 * r.probability:.0f} % {how}" for how, r in NAME_RECORDS.items()),
        certainty=as_markdown(certainty([*rows, *clean])),
        n=len(rows),
        n_all=len(all_large(0)),
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
        held=sum(abs(v) <= 3.0 for v in z),
        kept=len(z),
    )


def missions() -> list[list[str]]:
    """Return the table of the missions that distinguish two effects: attribution of the first before and after."""
    lines = [["boat", "effects to tell apart", "before", "with the designed mission", "with a mixed mission"]]
    for row in read(MISSIONS).values():
        kind, effect, _ = row["key"].split("/")
        found = [dict(pairs(row["diagnoses"][when])) for when in (BEFORE, DESIGNED, MIXED)]
        verdicts = [names.get(row["pair"][0], "not found") for names in found]
        lines.append([f"{effect}, {SIZES[kind]} size", " and ".join(row["pair"]), *verdicts])
    return lines


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
