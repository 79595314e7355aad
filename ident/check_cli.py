"""The command `seatrial ident check`: what `seatrial check LOG` asks ident about."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ident.cli_common import LOG


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
