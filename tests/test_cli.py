"""Tests of the main command: its imports, and its output for each kind of failure."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import types
import warnings
from collections.abc import Callable
from pathlib import Path

import click
import pytest

import seatrial as st
from seatrial import command_line
from seatrial.daq.errors import SafetyStop, SeatrialError, SeatrialWarning

HEAVY = {"numpy", "scipy", "casadi", "llvmlite", "plotly", "mcap", "can", "pymavlink", "rich", "jinja2"}
PARTS = {"seatrial.bench", "seatrial.ident", "seatrial.mocks"}

Outcome = tuple[int, str, str]  # exit status, stdout, stderr


def seatrial_process(*args: str, before: str = "") -> subprocess.CompletedProcess[str]:
    """Run `python -m seatrial` in its own interpreter."""
    code = f"import sys\n{before}\nfrom seatrial import command_line\ncommand_line.main(sys.argv[1:])"
    return subprocess.run([sys.executable, "-c", code, *args], capture_output=True, text=True, timeout=60)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Return a function that runs a command line in which the command `info` does a given action."""

    def run(action: Callable[[], object], *args: str) -> Outcome:
        part = types.ModuleType("part_of_the_test")
        part.command = click.command("info")(lambda: action())  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, part.__name__, part)
        monkeypatch.setitem(command_line.COMMANDS, "info", command_line.Row(f"{part.__name__}:command", "A test."))
        with pytest.raises(SystemExit) as leaving:
            command_line.main(args or ["info"])
        out, err = capsys.readouterr()
        return int(leaving.value.code or 0), out, err

    return run


def raising(error: BaseException) -> Callable[[], object]:
    def action() -> object:
        raise error

    return action


@pytest.mark.parametrize("option", ["--help", "-h", "--version"])
def test_help_imports_no_package_of_commands_and_no_large_library(option: str) -> None:
    report = "import atexit\natexit.register(lambda: print(sorted(sys.modules)))"
    done = seatrial_process(option, before=report)
    assert done.returncode == 0, done.stderr
    imported = set(ast.literal_eval(done.stdout.splitlines()[-1]))
    assert not imported & (HEAVY | PARTS)


def test_help_lists_every_command_with_its_description() -> None:
    text = seatrial_process("--help").stdout
    for name, row in command_line.COMMANDS.items():
        assert any(line.split() == [name, *row.short_help.split()] for line in text.splitlines())


def test_runs_as_a_module() -> None:
    words = [sys.executable, "-m", "seatrial", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "seatrial 0.2.0\n", "")
    assert st.__version__ == "0.2.0"


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (SeatrialError("rig.toml: no key `port`; add it"), 1, "rig.toml: no key `port`; add it"),
        (SeatrialError("two\n  lines"), 1, "two lines"),
        (SafetyStop("left motor above 80 degC; let it cool"), 3, "left motor above 80 degC; let it cool"),
        (click.ClickException("no such thing"), 1, "no such thing"),
        (SeatrialError("\x1b[2Ja \u202e\x07"), 1, "\\x1b[2Ja \\u202e\\x07"),
        (
            FileNotFoundError(2, "No such file or directory", "a.mcap"),
            1,
            "a.mcap: No such file or directory; check its path, its permissions and the space on the disk",
        ),
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 1, "the memory of this computer is not enough: give fewer or shorter logs"),
    ],
)
def test_a_failure_gives_a_one_line_error_and_a_status(run, error: BaseException, status: int, line: str) -> None:
    # After Ctrl-C an empty line first closes the ^C that the terminal shows.
    start = "\n" if status == 130 else ""
    assert run(raising(error)) == (status, "", f"{start}seatrial: {line}\n")


def test_an_unexpected_exception_gives_a_one_line_error_that_names_debug(run) -> None:
    status, out, err = run(raising(ValueError("bad\nshape")))
    assert (status, out) == (1, "")
    assert err.startswith("seatrial: internal error (ValueError: bad shape); run again with --debug")
    assert err.count("\n") == 1


@pytest.mark.parametrize("args", [("--debug", "info"), ("info", "--debug")])
@pytest.mark.parametrize(("error", "status"), [(ZeroDivisionError("oh"), 1), (SafetyStop("too hot"), 3)])
def test_debug_adds_the_traceback_and_keeps_the_status(run, args, error: Exception, status: int) -> None:
    got_status, _, err = run(raising(error), *args)
    assert got_status == status
    assert err.startswith("Traceback (most recent call last):")
    assert err.splitlines()[-1].startswith("seatrial: ")


def test_debug_after_a_double_dash_belongs_to_the_command(run) -> None:
    status, _, err = run(lambda: None, "info", "--", "--debug")
    assert status == 2
    assert "unexpected extra argument (--debug)" in err


@pytest.mark.parametrize("args", [("wrong",), ("--wrong",), ("info", "--wrong"), ("info", "too many")])
def test_wrong_usage_is_2(run, args) -> None:
    status, out, err = run(lambda: None, *args)
    assert (status, out) == (2, "")
    assert err.startswith("seatrial")
    assert "--help` shows how" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("infoo",), "seatrial: No such command 'infoo'. Did you mean 'info'? `seatrial --help` shows how"),
        (("imp",), "seatrial: No such command 'imp'. Did you mean 'import'? `seatrial --help` shows how"),
        (("fit",), "seatrial: No such command 'fit'. Did you mean 'seatrial ident vehicle'? `seatrial --help` shows"),
        (("plot", "x.mcap"), "seatrial: No such command 'plot'. Did you mean 'seatrial view'?"),
        (("vehicle", "x.mcap"), "seatrial: No such command 'vehicle'. Did you mean 'seatrial ident vehicle'?"),
        (("compare",), "seatrial: No such command 'compare'. Did you mean 'seatrial ident compare'?"),
        (
            ("evaluate", "x"),
            "seatrial: No such command 'evaluate'. Did you mean 'seatrial ident compare MODEL --on LOG'",
        ),
        (("ident", "evaluate", "x"), "seatrial ident: No such command 'evaluate'. To evaluate a model on a log: `seat"),
        (("ident", "validate", "x"), "seatrial ident: No such command 'validate'. To evaluate a model on a log: `seat"),
        (("ident", "test", "x"), "seatrial ident: No such command 'test'. To evaluate a model on a log: `seatrial"),
        (
            ("ident", "predict"),
            "seatrial ident: No such command 'predict'. To evaluate a model on a log: `seatrial ide",
        ),
        (("diagnos",), "seatrial: No such command 'diagnos'. Did you mean 'seatrial ident diagnose'?"),
        (("design",), "seatrial: No such command 'design'. Did you mean 'seatrial mission design'?"),
        (("mission", "runn"), "seatrial mission: No such command 'runn'. Did you mean 'run'?"),
        (("import", "raww", "x"), "seatrial import: No such file or command 'raww'. Did you mean 'raw'?"),
        (("log", "--duratoin", "3"), "seatrial log: No such option '--duratoin'. Did you mean '--duration'?"),
    ],
)
def test_a_misspelt_command_or_option_names_the_closest_one(capsys, args: tuple[str, ...], message: str) -> None:
    with pytest.raises(SystemExit) as leaving:
        command_line.main(args)
    assert leaving.value.code == 2
    assert capsys.readouterr().err.startswith(message)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (
            ("ident", "diagnose", "--jobs", "2"),
            "seatrial ident diagnose: No such option '--jobs'; `seatrial ident compare`, `seatrial ident fleet`, "
            "`seatrial ident changes` and 1 more have it; `seatrial ident diagnose --help` shows how\n",
        ),
        (
            ("ident", "vehicle", "--discriminate", "a,b"),
            "seatrial ident vehicle: No such option '--discriminate'; `seatrial mission design` has it; `seatrial",
        ),
        (("ident", "compare", "--validate", "x"), "seatrial ident compare: No such option '--validate'; `seatrial id"),
        (
            ("export", "vehicle", "--to", "fmu"),
            "seatrial export: Invalid value for '--to': 'fmu' is not a valid float range; `seatrial ident export --to "
            "fmu` has it; `seatrial export --help` shows how\n",
        ),
        (
            ("export", "vehicle", "--to", "fmx"),
            "seatrial export: Invalid value for '--to': 'fmx' is not a valid float range; `seatrial export --help`",
        ),
    ],
)
def test_an_option_of_other_commands_names_them(capsys, args: tuple[str, ...], message: str) -> None:
    """The commands of the same group come first, and options that are spelt similarly are not suggested."""
    with pytest.raises(SystemExit) as leaving:
        command_line.main(args)
    assert leaving.value.code == 2
    assert capsys.readouterr().err.startswith(message)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("import", "mapp.toml", "run1.csv"), "Path 'mapp.toml' does not exist. Did you mean 'map.toml'?"),
        (("import", "map.toml", "rnu1.csv"), "Path 'rnu1.csv' does not exist. Did you mean 'run1.csv'?"),
        (("check", "rnu1.mcap"), "Path 'rnu1.mcap' does not exist. Did you mean 'run1.mcap'?"),
        (("check", "other/nothing.mcap"), "Path 'other/nothing.mcap' does not exist; `seatrial"),
        (("ident", "diagnose", "vehicel", "run1.mcap"), "Path 'vehicel' does not exist. Did you mean 'vehicle'?"),
    ],
)
def test_a_missing_file_names_the_closest_one(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: tuple[str, ...], message: str
) -> None:
    for name in ("map.toml", "run1.csv", "run1.mcap", "vehicle"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as leaving:
        command_line.main(args)
    assert leaving.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", ["ident vehicle a.csv good.mcap b.csv", "ident changes --before a.csv good.mcap --after b.csv good.mcap",
              "ident vehicle good.mcap --validate a.csv --validate b.csv"],
)  # fmt: skip
def test_all_files_that_are_no_logs_are_named_before_a_command_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("t,u\n0,1\n", encoding="utf-8")
    (tmp_path / "good.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(SystemExit):
        command_line.main(words.split())
    said = capsys.readouterr()
    assert (
        "a.csv, b.csv: not MCAP logs; use `seatrial import` for logs of other formats: `seatrial import --guess a.csv "
        "b.csv -o map.toml`, then `seatrial import map.toml a.csv b.csv`"
    ) in " ".join(said.err.split())
    assert not said.out


def test_an_input_that_is_no_log_is_reported_before_an_output_that_exists(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "trial1.mat").touch()
    (tmp_path / "vehicle").mkdir()
    (tmp_path / "vehicle" / "result.json").touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        command_line.main(("ident", "vehicle", "trial1.mat"))
    assert "trial1.mat: not an MCAP log; use `seatrial import`" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    ["vehicle LOG", "thruster LOG", "diagnose model.toml LOG", "noise LOG", "information model.toml LOG",
     "navigate model.toml LOG", "compare model.toml --on LOG", "vehicle good.mcap --validate LOG"],
)  # fmt: skip
@pytest.mark.parametrize("place", ["first", "last"])
@pytest.mark.parametrize(
    ("log", "message"), [("none.mcap", "'none.mcap' does not exist"), ("a.mat", "not an MCAP log")]
)
def test_a_wrong_log_is_reported_before_an_output_that_exists(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    place: str,
    log: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.mat", "model.toml"):
        (tmp_path / name).touch()
    (tmp_path / "good.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").touch()
    command, *rest = words.replace("LOG", log).split()
    given = ["--out", "out", *rest] if place == "first" else [*rest, "--out", "out"]
    with pytest.raises(SystemExit):
        command_line.main(("ident", command, *given))
    err = capsys.readouterr().err
    assert message in " ".join(err.split())
    assert "exists already" not in err


def test_an_output_that_exists_is_reported_if_the_log_is_right(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "good.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").touch()
    with pytest.raises(SystemExit):
        command_line.main(("ident", "vehicle", "--out", "out", "good.mcap"))
    assert "out: exists already; --force replaces it" in capsys.readouterr().err


def test_the_table_of_groups_has_all_groups() -> None:
    context = click.Context(command_line.cli)
    commands = {name: command_line.cli.get_command(context, name) for name in command_line.COMMANDS}
    assert {n for n, c in commands.items() if isinstance(c, click.Group)} == set(command_line.GROUPS)
    for words in command_line.SYNONYMS.values():
        first, *rest = words.split()
        assert commands[first] is not None
        assert not rest or rest[0] in commands[first].commands


def test_an_import_with_the_map_last_says_that_it_comes_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("run.csv", "map.toml"):
        Path(name).write_text("t\n")
    with pytest.raises(SystemExit) as leaving:
        command_line.main(["import", "run.csv", "map.toml"])
    assert leaving.value.code == 2
    assert "run.csv: the import map map.toml comes first, then its source files" in capsys.readouterr().err


def test_exit_status_comes_from_ctx_exit_and_not_from_a_returned_value(run) -> None:
    assert run(lambda: 7) == (0, "", "")
    assert run(lambda: click.get_current_context().exit(7)) == (7, "", "")


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("no_such_part.cli:x", "`info` is not part of this installation (no module no_such_part)"),
        ("daq.no_such_file:x", "`info` is not part of this installation (no module daq.no_such_file)"),
        ("seatrial.daq.errors:x", "`info` is not part of this installation (no command seatrial.daq.errors:x)"),
        ("needs_a_library:x", "`info` needs the Python module no_such_library, which is not installed"),
    ],
)
def test_a_missing_package_gives_a_one_line_error(
    monkeypatch, tmp_path: Path, capsys, target: str, message: str
) -> None:
    (tmp_path / "needs_a_library.py").write_text("import no_such_library\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(command_line.COMMANDS, "info", command_line.Row(target, "A test."))
    with pytest.raises(SystemExit) as leaving:
        command_line.main(["info", "some.mcap"])
    err = capsys.readouterr().err
    assert leaving.value.code == 1
    assert err.startswith(f"seatrial: {message}")
    assert err.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="sends a signal the POSIX way")
@pytest.mark.parametrize("module", ["click", "numpy"])  # imported by the main program, and by the package of a command
def test_ctrl_c_during_imports_prints_one_line(tmp_path: Path, module: str) -> None:
    (tmp_path / f"{module}.py").write_text("import time\nprint('importing', flush=True)\ntime.sleep(60)\n")
    root = str(Path(command_line.__file__).parent)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), root])}
    command = [sys.executable, "-m", "seatrial", "info", __file__]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err == "\nseatrial: interrupted\n"  # the empty line closes the ^C that the terminal shows


@pytest.mark.skipif(os.name != "posix", reason="closes a pipe the POSIX way")
@pytest.mark.parametrize("command", ["--help", "info"])
def test_a_closed_output_pipe_does_not_give_an_error(tmp_path: Path, command: str) -> None:
    # `print` keeps the text until the last flush, where click's own output is flushed at once.
    (tmp_path / "prints.py").write_text("import click\ncommand = click.command()(lambda: print('text'))\n")
    code = f"""
import sys
sys.path.append({str(tmp_path)!r})
from seatrial import command_line
command_line.COMMANDS["info"] = command_line.Row("prints:command", "A test.")
command_line.main(sys.argv[1:])
"""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run([sys.executable, "-c", code, command], stdout=writer, stderr=subprocess.PIPE, timeout=60)
    finally:
        os.close(writer)
    assert done.stderr == b""


@pytest.mark.filterwarnings("always")
def test_warnings_of_seatrial_are_one_line_and_other_warnings_keep_their_location(run: Callable[..., Outcome]) -> None:
    def action() -> None:
        warnings.warn("the engine is slow", SeatrialWarning, stacklevel=1)
        warnings.warn("of a library", RuntimeWarning, stacklevel=1)

    with warnings.catch_warnings():
        warnings.showwarning = lambda message, category, *where: print(f"{category.__name__}: {message}")
        status, out, err = run(action)
    assert (status, out, err) == (0, "RuntimeWarning: of a library\n", "seatrial: the engine is slow\n")


def test_the_advice_after_a_bracket_is_separated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.toml", "b.mcap"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(SystemExit):
        command_line.main(["check", str(tmp_path / "a.toml"), str(tmp_path / "b.mcap")])
    assert "one or more logs (.mcap); `seatrial check --help` shows how" in capsys.readouterr().err


def test_the_hint_on_an_evaluation_names_the_command(capsys) -> None:
    with pytest.raises(SystemExit):
        command_line.main(("ident", "evaluate", "vehicle"))
    assert "`seatrial ident compare MODEL --on LOG`" in capsys.readouterr().err
