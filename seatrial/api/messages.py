"""Messages of the workflows in the words of the Python interface: its arguments in place of command-line options."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    "--test-homogeneity": "homogeneity",
    "--force": "force=True", "--despite-faults": "despite_faults=True", "--no-reml": "reml=False",
    "--second-order": "mean_order=2", "--no-second-order": "mean_order=1", "--no-score-tests": "score_tests=False",
    "--thrust-curve": "thrust_curve", "--thrust-input": "thrust_input", "--source-only": "source_only=True",
    "--mass": "mass", "--inertia": "inertia", "--backend": "backend", "--scheduler": "scheduler", "--out": "out",
    "--from": "start of st.open_log", "--to": "end of st.open_log", "--out-dir": "out_dir",
    "-o": "out", "--jobs": "jobs", "--n-max": "n_max", "--max-speed": "max_speed", "--area": "area",
    "--energy": "energy", "--current": "current", "--evaluations": "evaluations", "--duration": "duration",
    "--discriminate": "between", "--rate": "rate", "--steps": "steps", "--seed": "seed", "--slew": "slew",
    "--prior-halfwidth": "prior_halfwidth",
    "--criterion": "criterion", "--parameters": "chosen", "--before": "before", "--after": "after", "--on": "logs",
    "--no-common-errors": "common_errors=False", "--false-discovery-rate": "false_discovery_rate",
    "--smooth": "smoothed=True", "--filter": "smoothed=False", "--name": "name", "--thrust-of": "thrust_of",
    "--with-disturbance-states": "with_disturbance_states=True",
}  # fmt: skip

# Options with values, which become one argument: --fix y_left=-0.3, --effect wind --effect lag, or --rate 10
VALUE = r"(?:[-+]?\w+(?:\.\w+)*(?:(?<=e)[-+]\d+)?|\.\.\.)"
# A value before a colon stays, as in the error "rate 1000: give a number from 1 to 200".
NUMBER = r"\d+(?:\.\d+)?(?:e[-+]?\d+)?(?:x\d+(?:\.\d+)?)?(?![\w:-]|[.,]\d)"
NAME = r"[A-Za-z]\w*(?:-\w+)*(?![\w:-])"
WITH_NUMBER = (
    "rate", "horizon", "max-effects", "settle", "n-max", "max-speed", "area", "energy", "current", "evaluations",
    "duration", "mass", "inertia", "jobs", "steps", "seed", "slew", "false-discovery-rate",
)  # fmt: skip
WITH_NAMES = ("effect", "exclude", "per-log", "profile", "test-homogeneity")  # they may be repeated
VALUE_OF_OPTION = re.compile(
    rf"(?P<of_parameter>--(?:fix|initial|prior)) (?P<name>[A-Za-z]\w*)=(?P<value>{VALUE})(?::(?P<sd>{VALUE}))?"
    rf"|(?P<of_names>--(?:{'|'.join(WITH_NAMES)})) (?P<item>{NAME})"
    rf"|(?P<of_number>--(?:{'|'.join(WITH_NUMBER)})) (?P<number>{NUMBER})"
    r"|(?P<of_model>--model) "
    r"(?P<model>(?:horizontal|nomoto|kinematic|surge|yaw)(?::[\w:-]*\w)?|[\w./-]+\.toml)(?![\w-]|: )"
)
VALUES_OF_OPTIONS = re.compile("{0}(?: {0})*".format("(?:" + re.sub(r"\?P<\w+>", "?:", VALUE_OF_OPTION.pattern) + ")"))
FLAG = re.compile(r" (--[a-z]+(?:-[a-z]+)*)$")  # an option without a value at the end of a command
OPTION = re.compile(r"(?<![\w-])(?:--[a-z]+(?:-[a-z]+)*|-o(?![\w-]))")
BOTH = re.compile(r"--[a-z]+(?:-[a-z]+)*, in Python ([^,)]+),?")  # a text that names an option and its argument
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

# A command outside of backticks, without arguments or with the word LOG
COMMAND = re.compile(
    rf"(?P<words>{'|'.join(sorted(FUNCTIONS, key=len, reverse=True))})(?: LOGS?\b|(?![\w/-]| [A-Z\d-]| \S*[./]\w))"
)
COMMAND_WITH_LOGS = re.compile(
    r"(?P<words>seatrial ident vehicle|seatrial check)(?P<logs> (?!-)(?:'[^']*'|[^\s']+))?(?P<options>(?: .*)?)$"
)

# Arguments of `st.thruster` that differ from those of the other functions
OF_THRUSTER = {"--thruster": "name"}
OF_DESIGN = {"--rate": "rates"}  # those of `st.design`
OF_IMPORT = {"-o": "out_dir"}  # those of `st.import_log`
OF_WINDOW = {"--from": "start", "--to": "end"}  # those of `st.open_log`


def in_python(text: str, own: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return a message with commands and their options replaced by functions and arguments of the Python interface.

    For example, ``--fix e_psi=0.03`` becomes ``fixed={'e_psi': 0.03}``, ``--rate 10`` becomes ``rate=10``, and a
    command without arguments becomes the function that it calls. Values after each other become one argument for each
    option. Options without an entry in the tables stay. So does a command with arguments between backticks, which can
    be run as it is, except these: a fit or check whose options are all known, an import or the guess of an import map
    without further options, and the design of a mission that discriminates two effects.
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
            return FUNCTIONS.get(part) or _as_call(part, arguments) or part
        part = COMMAND.sub(lambda found: _as_call(found.group(), arguments) or FUNCTIONS[found["words"]], part)
        part = BOTH.sub(r"\1", part)
        part = VALUES_OF_OPTIONS.sub(lambda found: _with_values(found.group(), arguments), part)
        return OPTION.sub(lambda found: arguments.get(found.group(), found.group()), part)

    return "`".join(replaced(part, i % 2 == 1) for i, part in enumerate(text.split("`")))


def _with_values(options: str, arguments: Mapping[str, str]) -> str:
    """Return options with values as arguments of Python, such as ``fixed={'y_left': -1, 'y_right': 1}, rate=10``.

    Python refuses an argument that is given twice, so all values of an option are in one dictionary or list. A prior
    with its standard deviation is a pair: ``priors={'c1': (40, 2)}``. An option that is followed by the next word of
    the sentence, and not by a value, stays.

    Parameters
    ----------
    options : str
        Match of `VALUES_OF_OPTIONS`.
    arguments : mapping
        Argument of each option.
    """
    parts, begun = list[str](), dict[str, list[str]]()
    for option in VALUE_OF_OPTION.finditer(options):
        if option["of_names"] and not _is_name(option["item"]):
            parts, begun = [*parts, *_arguments(begun, arguments), option.group()], {}
        elif option["of_parameter"]:
            value = option["value"] if option["sd"] is None else f"({option['value']}, {option['sd']})"
            begun.setdefault(option["of_parameter"], []).append(f"'{option['name']}': {value}")
        elif option["of_names"]:
            begun.setdefault(option["of_names"], []).append(f"'{option['item']}'")
        elif option["of_number"]:
            sides = option["number"].split("x")
            begun[option["of_number"]] = [sides[0] if len(sides) == 1 else f"({', '.join(sides)})"]
        else:
            begun["--model"] = [f"'{option['model']}'"]
    return " ".join([*parts, *_arguments(begun, arguments)])


def _arguments(values: Mapping[str, Sequence[str]], arguments: Mapping[str, str]) -> list[str]:
    """Return one text with the arguments of Python for the values of each option; an empty list without options."""
    brackets = {f"--{name}": ("[", "]") for name in WITH_NAMES}
    brackets |= dict.fromkeys(("--fix", "--initial", "--prior"), ("{", "}"))
    texts = []
    for option, words in values.items():
        left, right = brackets.get(option, ("", ""))
        texts.append(f"{arguments.get(option, option)}={left}{', '.join(words)}{right}")
    return [", ".join(texts)] if texts else []


def _is_name(word: str) -> bool:
    """Return whether a word is the name of an effect or parameter, and no word of English such as ``or``."""
    if re.search(r"[A-Z\d_-]", word):
        return True
    from seatrial.ident.effects import catalogue  # imported here, because it takes 0.1 s

    return word in catalogue()


def _as_call(command: str, arguments: Mapping[str, str]) -> str:
    """Return a fit or a check on the command line as a call of Python, such as ``st.fit(logs, effects=['wind'])``.

    The words ``LOGS`` and ``LOG`` for any logs become names. A fit without logs is one of ``logs``. The text is empty
    for another command, and if an option is not known.
    """
    found = COMMAND_WITH_LOGS.match(command)
    if found is None:
        return ""
    options, flags = found["options"], list[str]()
    while (flag := FLAG.search(options)) and flag[1] in arguments and "=" in arguments[flag[1]]:
        options, flags = options[: flag.start()], [arguments[flag[1]], *flags]
    values = options.strip()
    if values and not VALUES_OF_OPTIONS.fullmatch(values):
        return ""
    logs = (found["logs"] or "LOGS").strip()
    shown = logs.lower() if logs in ("LOG", "LOGS") else repr(shlex.split(logs)[0])
    words = [shown, *([_with_values(values, arguments)] if values else []), *flags]
    return f"{FUNCTIONS[found['words']]}({', '.join(words)})"


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

    def __init__(self, progress: bool | None = None, own: Mapping[str, str] = MappingProxyType({})) -> None:
        """Store whether each step of the computation has a line (``progress``); None: the user did not choose.

        ``own`` is that of `in_python`.
        """
        self._own = own
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
            print(in_python(line, self._own), file=sys.stderr, flush=True)

    def warning(self, text: str) -> None:
        """Issue a Python warning with this text and the category `SeatrialWarning`, which the user may filter."""
        self.issued.add(in_python(text, self._own))
        warn(in_python(text, self._own))


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


def with_texts_in_python(part: T, own: Mapping[str, str] = MappingProxyType({})) -> T:
    """Return a part of a result with all its texts in the words of the Python interface.

    The command of its provenance stays, and so do arrays and the keys of dictionaries. ``own`` is that of `in_python`.
    """
    return cast(T, _translated(part, own))


def _translated(part: Any, own: Mapping[str, str]) -> Any:
    """Return a text, tuple, dictionary or structure as `with_texts_in_python`; the same object if nothing changes."""
    if isinstance(part, str):
        text = in_python(part, own)
        return part if text == part else text
    if isinstance(part, tuple):
        items = tuple(_translated(item, own) for item in part)
        return part if all(a is b for a, b in zip(items, part, strict=True)) else items
    if isinstance(part, dict):
        changed = {key: new for key, old in part.items() if (new := _translated(old, own)) is not old}
        return part | changed if changed else part
    if isinstance(part, msgspec.Struct):
        values = {name: getattr(part, name) for name in part.__struct_fields__ if name != "command"}
        changed = {name: new for name, old in values.items() if (new := _translated(old, own)) is not old}
        return msgspec.structs.replace(part, **changed) if changed else part
    return part


@contextmanager
def errors_of_users(own: Mapping[str, str] = MappingProxyType({})) -> Iterator[None]:
    """Context that turns ValueError and KeyError of a computation into SeatrialError with the same text.

    A SeatrialError, and the new text of ValueError and KeyError, get the arguments of the Python interface in place of
    command-line options, for example ``fixed`` for ``--fix``. Classes derived from SeatrialError and other errors pass
    unchanged. The new error has the traceback and the cause of the old one, so that one traceback is shown. ``own`` is
    that of `in_python`.
    """
    try:
        yield
    except SeatrialError as problem:
        text = in_python(str(problem), own)
        if type(problem) is not SeatrialError or text == str(problem):
            raise
        raise SeatrialError(text).with_traceback(problem.__traceback__) from problem.__cause__
    except (ValueError, KeyError) as problem:
        text = in_python(str(problem).strip("'\""), own)
        raise SeatrialError(text).with_traceback(problem.__traceback__) from problem.__cause__
