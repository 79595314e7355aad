"""A user's own effects and models: loaded from files, kept by model.toml, wrong ones refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq.errors import SeatrialError
from ident.own import load_python, own_effects

OWN = """
from ident.model import Effect
from ident.params import Parameter

def pull(s):
    s.X = s.X - s.p.weed * s.x.u

EFFECT = Effect("weed", "weed on the hull", {"force": pull},
                (Parameter("weed", 0.0, "kg/s", "drag of the weed", prior=(0.0, 10.0), step=0.3),), requires=("hull",))
"""


def test_effects_of_a_file_are_found_by_name(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(OWN)
    assert own_effects(file)["weed"].title == "weed on the hull"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("EFFECT = 3\n", "neither EFFECT nor EFFECTS"),
        ("x = 1\n", "neither EFFECT"),
        ("1 / 0\n", "cannot be loaded: division"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "own.py"
    file.write_text(text)
    with pytest.raises(SeatrialError, match=said) as caught:
        own_effects(file)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match="no such Python file"):
        load_python(tmp_path / "nowhere.py")
