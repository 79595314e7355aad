"""Tests of the whole command tree: help with an example for each command, and shell completion."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from seatrial import command_line

PARTS = ("numpy", "rich", "seatrial.bench.", "seatrial.ident.", "seatrial.mocks.", "seatrial.daq.log.reader")


def commands(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Command]]:
    """Return (words, command) of every command that is not a group."""
    if not isinstance(command, click.Group):
        yield context.command_path, command
        return
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None, name
        yield from commands(found, click.Context(found, parent=context, info_name=name))


EVERY = dict(commands(command_line.cli, click.Context(command_line.cli, info_name="seatrial")))


@pytest.mark.parametrize("words", EVERY)
def test_every_command_helps_with_an_example_that_parses(words: str) -> None:
    command = EVERY[words]
    context = click.Context(command, info_name=words)
    text = " ".join(command.get_help(context).split())
    assert re.search(rf"Examples?: ((?!Example).)*{re.escape(words)}", text), f"{words} --help has no example of itself"
    assert command.help, words
    # Each option has a help text, unless its choices or its default explain it.
    for option in command.params:
        if isinstance(option, click.Option) and not option.hidden:
            assert option.help or option.type.name == "choice" or option.show_default, f"{words} {option.opts[0]}"


def test_every_output_option_has_the_same_names() -> None:
    options = [option for command in EVERY.values() for option in command.params]
    found = [set(option.opts) for option in options if {"-o", "--out", "--output"} & set(option.opts)]
    assert len(found) >= 20
    assert all(names == {"-o", "--out", "--output"} for names in found)


WITH_RESULT = (
    *("info", "devices", "check", "recover", "mission design"),
    *(f"ident {name}" for name in ("thruster", "vehicle", "diagnose", "study", "noise", "information")),
    *(f"ident {name}" for name in ("navigate", "compare", "fleet", "changes")),
    *(f"mission {name}" for name in ("show", "generate", "run")),
    *(f"bench {name}" for name in ("static", "steps", "chirp", "all")),
    *(f"import {name}" for name in ("map", "can", "mavlink", "raw")),
)


def test_every_command_with_a_result_prints_it_as_json() -> None:
    with_json = {words for words, command in EVERY.items() for o in command.params if "--json" in o.opts}
    assert with_json == {f"seatrial {name}" for name in WITH_RESULT}


def test_commands_that_write_a_named_file_have_force() -> None:
    """A recording never replaces another one, and a study only adds replicates; all others replace on request."""
    recording = ("bench", "mission run", "mission follow", "log", "check", "demo", "ident study")
    without = {
        words.removeprefix("seatrial ")
        for words, command in EVERY.items()
        if "--out" in {o for option in command.params for o in option.opts}
        and "--force" not in {o for option in command.params for o in option.opts}
    }
    assert {words for words in without if not words.startswith(recording)} == set()


RANGES = {
    f"{words} {option.opts[-1]}": option.type
    for words, command in EVERY.items()
    for option in command.params
    if isinstance(option.type, click.FloatRange)
}


@pytest.mark.parametrize("option", RANGES)
def test_a_number_range_accepts_only_finite_numbers(option: str) -> None:
    for text in ("nan", "inf"):
        with pytest.raises(click.BadParameter):
            RANGES[option].convert(text, None, None)


def complete(words: str) -> subprocess.CompletedProcess[str]:
    """Return the completions of the last word for bash. The names of the imported modules go to stderr."""
    environment = os.environ | {
        "_SEATRIAL_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split(" ")) - 1),
    }
    report = "import atexit, sys\natexit.register(lambda: print(*sys.modules, file=sys.stderr))\n"
    code = f"{report}from seatrial import command_line\ncommand_line.main()"
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60, check=False
    )


def offered(words: str) -> list[str]:
    return [line.partition(",")[2] for line in complete(words).stdout.splitlines()]


def test_the_shell_completes_commands_without_importing_their_package() -> None:
    done = complete("seatrial ")
    assert [line.partition(",")[2] for line in done.stdout.splitlines()] == list(command_line.COMMANDS)
    assert not [name for name in done.stderr.split() if name.startswith(PARTS)]


def test_the_shell_completes_subcommands_options_and_choices(tmp_path: Path) -> None:
    assert offered("seatrial mi") == ["mission"]
    assert {"design", "generate", "run", "show"} <= set(offered("seatrial mission "))
    assert offered("seatrial mission generate --ki") == ["--kind"]
    assert "zigzag" in offered("seatrial mission generate --kind ")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_scripts_of_the_docs_exist(shell: str) -> None:
    page = (Path(__file__).parents[1] / "docs/how-to/install.md").read_text(encoding="utf-8")
    assert f"_SEATRIAL_COMPLETE={shell}_source seatrial" in page
    code = "from seatrial import command_line; command_line.main()"
    # click asks bash for its version. Without such a shell it only warns.
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"_SEATRIAL_COMPLETE": f"{shell}_source"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0
    assert "_SEATRIAL_COMPLETE=" in done.stdout
