"""Results as JSON: seven digits, null for what is no number."""

from __future__ import annotations

import json

import numpy as np

from ident.results.content import to_json


def test_an_array_is_written_as_its_numbers_are_one_by_one() -> None:
    rng = np.random.default_rng(0)
    value = rng.normal(size=(40, 25)) * 10.0 ** rng.integers(-30, 30, (40, 25))
    value[0, :4] = [0.0, -0.0, np.nan, np.inf]
    value[1] = np.round(value[1] * 1e-3) * 1e3
    assert to_json(value) == [[to_json(float(v)) for v in row] for row in value]
    written = json.dumps(to_json(rng.uniform(0.1, 1.0, 1000)))[1:-1].split(", ")
    assert max(map(len, written)) == len("0.1234567")
    assert to_json(np.array([0.1], np.float32)) == [0.1]
    assert to_json({"a": np.arange(3), "b": (True, np.bool_(False), None, "x")}) == {
        "a": [0, 1, 2], "b": [True, False, None, "x"]}
    assert json.dumps(to_json(np.array([2.5]))) == "[2.5]"
