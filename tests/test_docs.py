"""Tests of the documentation: links exist, command lines parse, and example files are read."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from seatrial import command_line
from seatrial.daq.config.mission_file import parse_mission
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.importers.import_map import load_import_map
from seatrial.daq.log.reader import Log
from seatrial.ident.estimation.model_file import load_model
from seatrial.ident.models.catalogue import KNOWN_SIGNALS, make_model
from seatrial.ident.models.horizontal import SENSORS

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
SCRIPTS = sorted((ROOT / "docs").rglob("*.sh"))
FOLDERS = ("daq/", "bench/", "ident/", "mocks/", "tests/", "docs/")
# Files that the reader of a how-to writes, and files that the commands of the docs write.
YOURS = {"ident/effects/hull/weed.py", "tests/ident/effects/test_weed.py", "daq/protocol/os5000.py"}


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path, language: str) -> list[str]:
    """Return the fenced blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def how_to(title: str) -> Path:
    return ROOT / "docs/how-to" / f"{title}.md"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_and_files_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"^(<{7}|>{7}) ", text, re.MULTILINE), "two versions, not merged"
    links = [target.partition("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in target]
    missing = [link for link in links if link and not (page.parent / link).exists()]
    assert not missing
    quoted = [word for word in re.findall(r"`([\w./-]+)`", text) if word.startswith(FOLDERS) and word not in YOURS]
    assert not [word for word in quoted if not (ROOT / word).exists()]


@pytest.mark.parametrize("page", [ROOT / "docs/threats.md"], ids=name)
def test_the_tests_that_a_page_names_exist(page: Path) -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page.read_text(encoding="utf-8"))
    assert len(named) > 10
    assert not [f"{file}::{test}" for file, test in named if f"\ndef {test}(" not in (ROOT / file).read_text("utf-8")]


def shell_commands(page: Path) -> list[str]:
    """Return the command lines of the shell blocks of a page, in order."""
    return [line for block in blocks(page, "sh") for line in block.replace("\\\n", " ").splitlines() if line]


def shell_lines() -> Iterator[tuple[str, str]]:
    """Return (where, command line) of everything that a reader may copy."""
    for page in PAGES:
        for line in shell_commands(page):
            if line.startswith("seatrial "):
                yield name(page), line
        for block in blocks(page, "console"):
            for line in block.splitlines():
                if line.startswith("$ seatrial "):
                    yield name(page), line.removeprefix("$ ")
    for script in SCRIPTS:
        for line in script.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
            if line.strip().startswith("seatrial "):
                yield name(script), line.strip()


@pytest.fixture
def no_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make click accept paths of files that do not exist."""
    monkeypatch.setattr(click.Path, "convert", lambda self, value, param, ctx: Path(value))


@pytest.mark.parametrize(("where", "line"), sorted(set(shell_lines())))
def test_command_lines_parse(where: str, line: str, no_files: None) -> None:
    words = [word for word in shlex.split(line, comments=True) if word != "&"]
    command, rest = resolve(words[1:])
    assert not isinstance(command, click.Group), f"{where}: {line} names no command"
    command.make_context("seatrial", rest)  # raises on an unknown option, a value out of range, a missing argument


def resolve(words: list[str]) -> tuple[click.Command, list[str]]:
    """Return the command that the words name, and the words after its name."""
    command: click.Command = command_line.cli
    context = click.Context(command)
    while isinstance(command, click.Group) and words:
        if (default := getattr(command, "default", "")) and words[0] not in command.commands:
            command = command.commands[default]  # the name may be left out
            break
        if words[0].startswith("-"):
            break
        found = command.get_command(context, words[0])
        assert found is not None, f"no command {words[0]!r} in {' '.join(words)}"
        command, words = found, words[1:]
    return command, words


def mentions() -> list[tuple[str, str]]:
    """Return (where, words) of commands quoted in the text. `a|b` stands for two commands."""
    found = set()
    for page in PAGES:
        text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for quoted in re.findall(r"`seatrial ([^`]+)`", text):
            words = quoted.split()
            for k, word in enumerate(words[:2]):
                if "|" in word:
                    found |= {(name(page), " ".join([*words[:k], one, *words[k + 1 :]])) for one in word.split("|")}
                    break
            else:
                found.add((name(page), " ".join(words)))
    return sorted(found)


@pytest.mark.parametrize(("where", "words"), mentions())
def test_commands_in_the_text_exist(where: str, words: str) -> None:
    if words == "...":
        return
    command, rest = resolve([word for word in words.split() if word != "..."])
    known = {option for p in command.params for option in (*p.opts, *p.secondary_opts)}
    known |= {"--help", "--debug", "--version"}
    unknown = [word for word in rest if word.startswith("-") and word.partition("=")[0] not in known]
    assert not unknown, f"{where}: `seatrial {words}`"


def test_the_rig_files_of_the_docs_are_valid() -> None:
    for page in (ROOT / "docs/formats/rig.md", how_to("own-boat")):
        (text, *_) = blocks(page, "toml")
        rig = parse_rig(text, ROOT / "rig.toml")
        assert rig.devices
        assert rig.thrusters
    (part,) = blocks(ROOT / "README.md", "toml")
    assert parse_rig(f'format = "seatrial-rig 1"\nname = "readme"\n{part}', ROOT / "rig.toml").device("ahrs")


def test_the_mission_of_the_docs_is_valid() -> None:
    (text,) = blocks(ROOT / "docs/formats/mission.md", "toml")
    mission = parse_mission(text, "mission.md")
    assert mission.end == 300.0
    assert [segment.name for segment in mission.segments] == ["static", "steps up"]


def test_the_maps_of_the_docs_are_valid(tmp_path: Path) -> None:
    for k, text in enumerate(blocks(ROOT / "docs/formats/import.md", "toml")):
        path = tmp_path / f"map{k}.toml"
        path.write_text(text, encoding="utf-8")
        load_import_map(path)
    for path in sorted((ROOT / "docs/examples").rglob("*.toml")):
        if "seatrial-import-csv" in path.read_text(encoding="utf-8"):
            load_import_map(path)


def test_the_import_page_lists_the_signals_that_models_use() -> None:
    page = (ROOT / "docs/formats/import.md").read_text(encoding="utf-8").split("## Signals that models take")[1]
    listed = re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in page.splitlines() if line.startswith("|")))
    assert sorted(listed) == sorted(KNOWN_SIGNALS)
    plane = [make_model(f"horizontal:{kind}", tuple(SENSORS)) for kind in ("shaft", "command", "force", "general")]
    others = [make_model(source) for source in ("kinematic:shaft:yaw", "surge:shaft", "surge", "yaw")]
    signals = [v for m in (*plane, *others) for v in (*m.inputs, *m.outputs)]
    taken = {getattr(v, "tap_of", "") or v.name: v.unit for v in signals}
    bench_and_made = ("force", "speed")
    assert {n: u for n, u in KNOWN_SIGNALS.items() if n not in bench_and_made} == taken


def test_the_model_of_the_docs_is_valid(tmp_path: Path) -> None:
    text, curve = blocks(ROOT / "docs/formats/model.md", "toml")
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    saved = load_model(path)
    assert saved.model.parameter("m_u").value == 35.53
    assert saved.errors["m_u"] == 0.19
    assert [e.name for e in saved.model.effects] == ["disturbance", "sensor-bias", "cubic-drag"]
    path.write_text(text.replace('"cubic-drag"', '"unknown X(u)"').replace("[provenance]", f"{curve}\n[provenance]"))
    assert load_model(path).model.effects[-1].name == "unknown X(u)"


def test_the_content_of_a_log_matches_the_docs() -> None:
    (text,) = blocks(ROOT / "docs/formats/log.md", "python")
    words = set(re.findall(r"\blog\.(\w+)", text.replace("seatrial.daq.log.reader.open_log", "")))
    assert {"table", "sources", "rig"} <= words
    stored = {*Log.__init__.__code__.co_names, *Log._use_index.__code__.co_names}
    known = set(dir(Log)) | stored | set(getattr(Log, "__annotations__", ()))
    assert not words - known
