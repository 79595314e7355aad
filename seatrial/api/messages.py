"""Messages of the workflows in the words of the Python interface: its arguments in place of command-line options."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar, cast

import msgspec

from seatrial.daq.errors import SeatrialError, warn
from seatrial.ident.reporter import StepLines

if TYPE_CHECKING:
    from seatrial.ident.results import Result

T = TypeVar("T")

# Arguments of the functions of `seatrial` by the command-line option. An option without an entry stays as it is.
ARGUMENTS = {
    "--fix": "fixed", "--prior": "priors", "--initial": "initial", "--effect": "effects", "--effects": "effects_file",
    "--per-log": "per_log", "--validate": "validate", "--max-effects": "max_effects", "--exclude": "exclude",
    "--model": "model", "--horizon": "horizon", "--gnss-outage": "gnss_outages",
    "--thruster": "thruster", "--robust": "outlier_model", "--profile": "profiles", "--settle": "settle",
    "--force": "force=True", "--despite-faults": "despite_faults=True", "--no-reml": "reml=False",
    "--second-order": "mean_order=2", "--no-second-order": "mean_order=1", "--no-score-tests": "score_tests=False",
    "--thrust-curve": "thrust_curve", "--thrust-input": "thrust_input", "--source-only": "source_only=True",
    "--mass": "mass", "--inertia": "inertia", "--backend": "backend", "--scheduler": "scheduler", "--out": "out",
    "--from": "start of st.open_log", "--to": "end of st.open_log", "--out-dir": "out_dir",
    "-o": "out", "--jobs": "jobs", "--n-max": "n_max", "--max-speed": "max_speed", "--area": "area",
    "--energy": "energy", "--current": "current", "--evaluations": "evaluations", "--duration": "duration",
    "--discriminate": "between",
}  # fmt: skip

# An option with the value of a parameter, such as --fix y_left=-0.3, --initial NAME=VALUE or --prior c1=40:2
VALUE = r"(?:[-+]?\w+(?:\.\w+)*(?:(?<=e)[-+]\d+)?|\.\.\.)"
VALUE_OF_PARAMETER = re.compile(
    rf"(?P<option>--(?:fix|initial|prior)) (?P<name>[A-Za-z]\w*)=(?P<value>{VALUE})(?::(?P<sd>{VALUE}))?"
)
VALUES_OF_PARAMETERS = re.compile(  # several of them in sequence
    "{0}(?: {0})*".format(re.sub(r"\?P<\w+>", "?:", VALUE_OF_PARAMETER.pattern))
)
OPTION = re.compile(r"(?<![\w-])(?:--[a-z]+(?:-[a-z]+)*|-o(?![\w-]))")
IMPORT = "seatrial import "  # command that st.import_log replaces, before the paths
GUESS = f"{IMPORT}--guess "  # command that st.import_log without a map or st.guess_map replaces
DESIGN = "seatrial mission design "  # command that st.design replaces, before the model

# Functions of `seatrial` by the command that calls them, in a text between backticks.
FUNCTIONS = {
    "seatrial check": "st.check", "seatrial import": "st.import_log", "seatrial ident changes": "st.compare_campaigns",
    "seatrial ident compare": "st.compare", "seatrial ident diagnose": "st.diagnose",
    "seatrial ident export": "st.export", "seatrial ident fleet": "st.fit_many",
    "seatrial ident navigate": "st.navigate", "seatrial ident thruster": "st.thruster",
    "seatrial ident vehicle": "st.fit", "seatrial mission design": "st.design",
}  # fmt: skip


# Arguments of `st.thruster` that differ from those of the other functions
OF_THRUSTER = {"--thruster": "name"}
OF_IMPORT = {"-o": "out_dir"}  # those of `st.import_log`
OF_WINDOW = {"--from": "start", "--to": "end"}  # those of `st.open_log`


def in_python(text: str, own: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return a message with commands and their options replaced by functions and arguments of the Python interface.

    For example, ``--fix e_psi=0.03`` becomes ``fixed={'e_psi': 0.03}``, and a command without arguments between
    backticks becomes the function that it calls. Values after each other become one argument for each option. Options
    without an entry in the tables stay. So does a command with arguments, which can be run as it is, except an
    import or the guess of an import map without further options, which become ``st.import_log`` and ``st.guess_map``,
    and the design of a mission that discriminates two effects, which becomes ``st.design``.
    ``own`` has the arguments of a function that differ from those of the others, by the option.
    """
    arguments = {**ARGUMENTS, **own}

    def replaced(part: str, between_backticks: bool) -> str:
        """Return a part of the message, between two backticks or outside of them, in the words of Python."""
        if between_backticks and part.startswith(IMPORT):
            return _as_import(part)
        if between_backticks and part.startswith(DESIGN):
            return _as_design(part)
        if between_backticks and part.startswith("seatrial "):
            return FUNCTIONS.get(part, part)
        part = VALUES_OF_PARAMETERS.sub(_as_dictionaries, part)
        return OPTION.sub(lambda found: arguments.get(found.group(), found.group()), part)

    return "`".join(replaced(part, i % 2 == 1) for i, part in enumerate(text.split("`")))


def _as_dictionaries(options: re.Match[str]) -> str:
    """Return a match of `VALUES_OF_PARAMETERS` as arguments of Python, such as ``fixed={'y_left': -1, 'y_right': 1}``.

    Python refuses an argument that is given twice, so all values of an option are in one dictionary. A prior with its
    standard deviation is a pair: ``priors={'c1': (40, 2)}``.
    """
    found: dict[str, list[str]] = {}
    for option in VALUE_OF_PARAMETER.finditer(options.group()):
        value = option["value"] if option["sd"] is None else f"({option['value']}, {option['sd']})"
        found.setdefault(ARGUMENTS[option["option"]], []).append(f"'{option['name']}': {value}")
    return ", ".join(f"{argument}={{{', '.join(values)}}}" for argument, values in found.items())


def _as_import(command: str) -> str:
    """Return a command of `seatrial import` as a call of Python; unchanged if it has further options.

    A guess with ``-o`` becomes ``st.guess_map``, a guess without it and an import with a map ``st.import_log``. The
    word ``FILE...`` for any files becomes the name ``files``.
    """
    is_guess = command.startswith(GUESS)
    words = shlex.split(command.removeprefix(GUESS if is_guess else IMPORT))
    if is_guess and words[-2:-1] == ["-o"]:
        paths, of_map = words[:-2], words[-1]
    else:
        paths, of_map = (words, "") if is_guess else (words[1:], words[0])
    if (
        not paths
        or any(word.startswith("-") for word in (*paths, of_map))
        or not (is_guess or of_map.endswith(".toml"))
    ):
        return command
    files = "files" if paths == ["FILE..."] else repr(paths[0] if len(paths) == 1 else paths)
    return f"st.{'guess_map' if is_guess and of_map else 'import_log'}({files}{f', {of_map!r}' if of_map else ''})"


def _as_design(command: str) -> str:
    """Return the command that designs a mission for two effects as a call of Python; unchanged if it is another one.

    The command needs no file of the mission, but the function does: it is ``tell-apart.toml``. The model is the result
    of the diagnosis, which the user may not have saved.
    """
    words = shlex.split(command.removeprefix(DESIGN))
    if len(words) != 3 or words[0].startswith("-") or words[1] != "--discriminate":
        return command
    return f"st.design(diagnosis, 'tell-apart.toml', between={tuple(words[2].split(','))!r})"


def _is_interactive() -> bool:
    """Return whether a user reads stderr: at a terminal, or in a notebook, whose kernel is ipykernel."""
    return "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())


class Messages:
    """Receiver of the messages of a workflow (fit, diagnosis, ...) in the Python interface.

    Warnings become Python warnings. Lines of progress are printed to stderr: one for each step if the user has asked
    for them, and one in 30 s if the user has not chosen and sits at a terminal or notebook.
    """

    def __init__(self, progress: bool | None = None) -> None:
        """Store whether each step of the computation has a line (``progress``); None: the user did not choose."""
        self._progress = _is_interactive() if progress is None else progress
        self._lines = StepLines(every_step=progress is not None)
        self.issued: set[str] = set()  # texts of the warnings

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Print the line `text` about a step of the computation to stderr, if one is due; else do nothing.

        ``times`` returns the time so far and the time left, which are printed before the text.
        """
        self._print(self._lines.start(text, times))

    def detail(self, text: str) -> None:
        """Print how far the step is to stderr, if progress is printed and its last line is at least 30 s old."""
        self._print(self._lines.detail(text))

    def _print(self, line: str) -> None:
        """Print a line of progress to stderr, if progress is printed and the line is not empty."""
        if self._progress and line:
            print(in_python(line), file=sys.stderr, flush=True)

    def warning(self, text: str) -> None:
        """Issue a Python warning with this text and the category `SeatrialWarning`, which the user may filter."""
        self.issued.add(in_python(text))
        warn(in_python(text))


def warn_of_result(result: Result, messages: Messages) -> None:
    """Issue each warning of a result once as a Python warning, except those that the computation has issued before.

    ``messages`` are those of the computation.
    """
    for text in dict.fromkeys(in_python(w.text) for w in result.warnings):
        if text not in messages.issued:
            warn(text)


def text_of(result: Result) -> str:
    """Return a result as text: the answer and the tables that the command prints, 100 columns wide."""
    from io import StringIO

    from rich.console import Console

    from seatrial.ident.report import print_result

    text = StringIO()
    shown = with_texts_in_python(result)  # before the lines are broken, which may part an option from its value
    print_result(shown, Console(file=text, width=100, highlight=False, color_system=None, force_jupyter=False))
    return in_python("\n".join(line.rstrip() for line in text.getvalue().strip("\n").splitlines()))


def with_texts_in_python(part: T) -> T:
    """Return a part of a result with all its texts in the words of the Python interface.

    The command of its provenance stays, and so do arrays and the keys of dictionaries.
    """
    return cast(T, _translated(part))


def _translated(part: Any) -> Any:
    """Return a text, tuple, dictionary or structure as `with_texts_in_python`; the same object if nothing changes."""
    if isinstance(part, str):
        text = in_python(part)
        return part if text == part else text
    if isinstance(part, tuple):
        items = tuple(map(_translated, part))
        return part if all(a is b for a, b in zip(items, part, strict=True)) else items
    if isinstance(part, dict):
        changed = {key: new for key, old in part.items() if (new := _translated(old)) is not old}
        return part | changed if changed else part
    if isinstance(part, msgspec.Struct):
        values = {name: getattr(part, name) for name in part.__struct_fields__ if name != "command"}
        changed = {name: new for name, old in values.items() if (new := _translated(old)) is not old}
        return msgspec.structs.replace(part, **changed) if changed else part
    return part


@contextmanager
def errors_of_users(own: Mapping[str, str] = MappingProxyType({})) -> Iterator[None]:
    """Context that turns ValueError and KeyError of a computation into SeatrialError with the same text.

    A SeatrialError, and the new text of ValueError and KeyError, get the arguments of the Python interface in place of
    command-line options, for example ``fixed`` for ``--fix``. Classes derived from SeatrialError and other errors pass
    unchanged. The new error has the old one as its cause. ``own`` is that of `in_python`.
    """
    try:
        yield
    except SeatrialError as problem:
        text = in_python(str(problem), own)
        if type(problem) is not SeatrialError or text == str(problem):
            raise
        raise SeatrialError(text) from problem
    except (ValueError, KeyError) as problem:
        raise SeatrialError(in_python(str(problem).strip("'\""), own)) from problem
