"""The commands `seatrial ident check` and `check-page`: what `seatrial check` asks ident about."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from daq.errors import SeatrialError
from ident.cli_common import LOG, command_line

FORMAT = "seatrial-check 1"


@click.command(hidden=True, epilog="Example: seatrial ident check run.mcap")
@click.argument("logs", nargs=-1, required=True, type=LOG)
@click.option("--quiet", is_flag=True, help="Print nothing; for a command that asks within the same process.")
def check(logs: tuple[Path, ...], quiet: bool) -> list[list[dict[str, str]]]:
    """Findings from the motion in LOGS, as JSON: one list a log. `seatrial check LOG` shows them to people."""
    from ident.check_log import as_dicts

    found = [as_dicts(path) for path in logs]
    if not quiet:
        click.echo(json.dumps(found))
    return found


@click.command("check-page", hidden=True,
               epilog="Example: seatrial ident check-page run.mcap --findings check.json --out check.html")
@click.argument("logs", nargs=-1, type=LOG)
@click.option("--findings", required=True, type=LOG, help="What `seatrial check --json` printed.")
@click.option("--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The page to write.")
def check_page(logs: tuple[Path, ...], findings: Path, out: Path) -> None:
    """Write the page of a check with what is in LOGS as evidence; `seatrial check --report` asks for it."""
    from ident.check_evidence import envelope, evidence
    from ident.report.check_page import write_check_page

    content = _content(findings)
    content = envelope(content, [path.name for path in logs], command_line())
    name = content["subject"] if content.get("rig") and len(logs) == 1 else ""
    write_check_page(content | {"logs": [evidence(path, name) for path in logs]}, out)


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise SeatrialError(f"{path}: no JSON ({error}); write it with seatrial check --json") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise SeatrialError(f"{path}: not of format {FORMAT!r}; write it with seatrial check --json")
    return content
