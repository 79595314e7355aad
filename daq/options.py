"""Options that several commands share: their types, the output option, and --json with its output."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, final

import click

from seatrial.daq.errors import closest_file, closest_name

T = TypeVar("T")
FEW_CHOICES = 8  # values of an option that an error message lists although it suggests one


def output_option(kind: click.ParamType[Any], words: str, **attributes: Any) -> Callable[..., Any]:
    """Return a decorator that adds the option for the output of a command: `-o`, `--out` or `--output`.

    The command receives the value as `out`; None without the option and without a default.

    Parameters
    ----------
    kind
        Type of the value: a file or a folder.
    words
        Help text.
    attributes
        Further arguments of `click.option`, such as `required` or `callback`.
    """
    return click.option("-o", "--out", "--output", "out", type=kind, help=words, **attributes)


def json_option(words: str = "Print the result as JSON, and everything else on stderr.") -> Callable[..., Any]:
    """Return a decorator that adds the flag `--json`. The command receives it as `as_json`.

    With the flag a command prints one JSON document on stdout and nothing else; progress, warnings and the paths of
    written files go to stderr. `words` is the help text.
    """
    return click.option("--json", "as_json", is_flag=True, help=words)


def print_json(value: Any) -> None:
    """Print a value as one JSON document on stdout, indented.

    Dataclasses and mappings become objects, sequences become lists, and paths become texts. NaN and infinity become
    null. Text or bytes are a document that is already written.
    """
    import msgspec

    written = value if isinstance(value, str | bytes) else msgspec.json.encode(value, enc_hook=str)
    click.echo(msgspec.json.format(written, indent=2))


class ExistingPath(click.Path):
    """Type of an argument that is an existing file or folder. The error of a missing one has the closest file name."""

    def __init__(self, *, dir_okay: bool = True) -> None:
        """Make the type. With `dir_okay` false, a folder is an error. Its values become `Path` objects."""
        super().__init__(exists=True, dir_okay=dir_okay, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path. A path that does not exist, or of another kind, is a usage error."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            path = Path(value)
            near = None if path.exists() else closest_file(path)
            if near is None:
                raise
            self.fail(f"{error.message} Did you mean {str(near)!r}?", param, ctx)


@final
class FiniteRange(click.FloatRange):
    """Type of an option that takes finite numbers within bounds. The range of click would accept `nan`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the value of a command-line option as a number.

        A value that is not a finite number within the bounds of the option is a usage error.
        """
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


@final
class Choice(click.Choice[T]):
    """Type of an option or argument with a fixed set of values, whose error suggests the most similar value.

    Attributes
    ----------
    meant : mapping of str to str
        Text of the suggestion for words that are no values but have one meaning, by the word in small letters.
    """

    def __init__(self, choices: Iterable[T], meant: Mapping[str, str] = MappingProxyType({})) -> None:
        """Make the type from its values, and the suggestions for other words."""
        super().__init__(choices)
        self.meant = meant

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        """Return the message about an invalid value: all valid ones, and the one that the user probably meant.

        If there is such a value and there are more than `FEW_CHOICES`, the others are not in the message but in the
        help.
        """
        near = closest_name(str(value), map(str, self.choices))
        if near and len(self.choices) > FEW_CHOICES:
            return (
                f"{value!r} is not one of the {len(self.choices)} values; did you mean {near!r}? All are in the help."
            )
        meant = self.meant.get(str(value).lower()) or (repr(near) if near else "")
        return super().get_invalid_choice_message(value, ctx) + (f" Did you mean {meant}?" if meant else "")


def view_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command that records a log with the flag `--view`. The command receives it as `view`."""
    text = "Also serve the page of `seatrial view` for the browser of this computer. Its address is printed."
    return click.option("--view", is_flag=True, help=text)(command)


def parsed_by(parse: Callable[[str], Any]) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Return a callback that parses the text of an option, or each text of an option that may be repeated.

    An option that is not given stays None, or empty. A ValueError of `parse` is a usage error with its message.
    """

    def callback(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
        """Return the parsed text or texts (click callback)."""
        if value is None:
            return None
        try:
            return [parse(text) for text in value] if parameter.multiple else parse(value)
        except ValueError as error:
            raise click.BadParameter(str(error), context, parameter) from None

    return callback
