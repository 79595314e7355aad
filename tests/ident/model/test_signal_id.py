"""Names of signals and their components."""

from __future__ import annotations

import pytest

from seatrial.ident.model import (
    COMMAND,
    SHAFT_SPEED,
    SignalId,
    command_of,
    commanded_thrusters,
    drive_word,
    is_of_thruster,
    shaft_speed_of,
    tap_name,
    thrust_of,
)


@pytest.mark.parametrize(
    ("name", "signal"),
    [
        ("psi", SignalId("", "psi")),
        ("n", SignalId("", "n")),
        ("X_n", SignalId("", "X_n")),
        ("speed_x", SignalId("", "speed_x")),
        ("n_left", SignalId("left", "n")),
        ("n_cmd_left", SignalId("left", "n_cmd")),
        ("n_cmd_aft_port", SignalId("aft_port", "n_cmd")),
        ("f_right", SignalId("right", "f")),
        ("servo_1", SignalId("1", "servo")),
        ("n_cmd_left~3", SignalId("left", "n_cmd", 3)),
        ("u~12", SignalId("", "u", 12)),
        ("u~0", SignalId("", "u~0")),
        ("u~old", SignalId("", "u~old")),
        ("n_", SignalId("", "n_")),
        ("", SignalId("", "")),
    ],
)
def test_name_is_separated_and_composed_again(name: str, signal: SignalId) -> None:
    assert SignalId.parse(name) == signal
    assert str(signal) == name


def test_names_of_one_thruster() -> None:
    assert (command_of("left"), shaft_speed_of("left"), thrust_of("left")) == ("n_cmd_left", "n_left", "f_left")
    assert tap_name("n_left", 3) == "n_left~3"
    assert tap_name("n_left", 0) == "n_left"
    assert tap_name("n_left", -1) == "n_left~-1"


def test_quantity_of_a_thruster_is_recognised() -> None:
    assert is_of_thruster("n_left", COMMAND, SHAFT_SPEED)
    assert not is_of_thruster("n_cmd_left", SHAFT_SPEED)
    assert not is_of_thruster("n", SHAFT_SPEED)  # a shaft speed, but of no named thruster


def test_commanded_thrusters_keep_the_order_of_the_names() -> None:
    assert commanded_thrusters(["n_cmd_right", "psi", "n_left", "n_cmd_left"]) == ["right", "left"]


@pytest.mark.parametrize(
    ("names", "word"),
    [
        (["theta", "n_left", "n_right"], "shaft speed"),
        (["n_cmd_left~2", "n_cmd_right"], "command"),
        (["f_left"], "thrust"),
        (["X", "N"], "command"),
        ([], "command"),
    ],
)
def test_inputs_of_a_boat_have_a_word(names: list[str], word: str) -> None:
    assert drive_word(names) == word
