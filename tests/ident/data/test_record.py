"""Tests of records: block means, holds, gaps, masks, delayed inputs, work, and clear errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.data.record import (
    WORK_UNIT,
    Channel,
    Record,
    block_mean,
    build_record,
    given_inputs,
    held_lines,
    sample_and_hold,
)
from seatrial.ident.model.delayed_inputs import HISTORY_STEP
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Effect, Input, Model, Output, Sensor, State, plain_model
from seatrial.ident.results.answers import cut_records


def model(hold: str = "zero", feels: str = "") -> Model:
    """Return a model with one input, an angle, and a pair of outputs of one sensor. ``feels`` names the output that
    contains the input.
    """
    return plain_model(
        "cart",
        f=lambda x, u, p: {"s": u.w},
        h=lambda x, u, p: {n: u.w if n == feels else x.s for n in ("psi", "a", "b", "x")},
        states=(State("s"),),
        inputs=(Input("w", "N", hold),),  # type: ignore[arg-type]
        sensors=(
            Sensor("compass", (Output("psi", "rad", "e", angle=True),)),
            Sensor("pair", (Output("a", "m", "e"), Output("b", "m", "e"))),
        ),
        parameters=(Parameter("e", 0.1),),
    )


def with_inputs(*names: str) -> Model:
    return model() + Effect("more", "more", {}, inputs=tuple(Input(n, "", "linear") for n in names))


def with_taps(*taps: int) -> Model:
    """Return the model with delayed taps of an input g."""
    g = Input("g", "", "linear")
    return model() + Effect("more", "more", {}, inputs=tuple(g.delayed(k) for k in taps))


def channel(rate: float, seconds: float = 10.0, start: float = 0.0, f: object = np.sin) -> Channel:
    t = start + np.arange(0.0, seconds + 1e-9, 1 / rate)
    return Channel(t, np.asarray(f(t), float))  # type: ignore[operator]


def channels(rate: float = 50.0) -> dict[str, Channel]:
    return {
        "w": Channel(np.array([0.0, 2.04, 5.0, 10.0]), np.array([1.0, -2.0, 3.0, 3.0])),
        "psi": channel(rate, f=lambda t: 0.2 * t),
        "a": channel(4.0),
        "b": channel(4.0, f=np.cos),
    }


def test_fast_sensor_is_averaged_and_a_slow_one_keeps_its_times() -> None:
    """The means of the fast sensor are at the times of the slow one, and at two instants between them."""
    record = build_record(model(), channels(), rate=10.0)
    psi, pair = record.y[:, 0], record.y[:, 1:]
    seen = np.isfinite(psi)
    np.testing.assert_allclose(record.t[seen], np.arange(121) / 12, atol=1e-9)
    np.testing.assert_allclose(psi[seen], 0.2 * record.t[seen], atol=1e-9)
    whole = np.isfinite(pair).all(axis=1)
    np.testing.assert_array_equal(np.isfinite(pair).any(axis=1), whole)
    np.testing.assert_allclose(record.t[whole], np.arange(0, 10.01, 0.25), atol=1e-9)
    np.testing.assert_allclose(pair[whole], np.column_stack([np.sin(record.t[whole]), np.cos(record.t[whole])]))
    assert record.outputs == ("psi", "a", "b")


def jittered(rate: float, seed: int, seconds: float = 60.0) -> np.ndarray:
    """Return times [s] of samples that are up to a fifth of an interval late."""
    return np.arange(0.0, seconds, 1 / rate) + np.random.default_rng(seed).uniform(
        0.0, 0.2 / rate, round(seconds * rate)
    )


def test_sensors_with_own_times_share_rows() -> None:
    """Heading at 20 Hz, a pair at 50 Hz and positions at 5 Hz, all with other stamps, need 10 rows a second."""
    boat = model()
    boat = replace(boat, sensors=(*boat.sensors, Sensor("fix", (Output("x", "m", "e"),))))
    wave = lambda t: np.sin(1.5 * t)  # noqa: E731
    at = {n: jittered(rate, i) for i, (n, rate) in enumerate({"psi": 20.0, "a": 50.0, "x": 5.0}.items())}
    at["b"] = at["a"]
    signals = {n: Channel(t, 3.0 + wave(t)) for n, t in at.items()}
    record = build_record(boat, signals | {"w": channels()["w"]}, t_to=59.0)
    seen = np.isfinite(record.y)
    assert record.n_rows < 1.1 * 590
    assert (seen[:, :3].sum(axis=0) > 0.97 * record.n_rows).all()
    np.testing.assert_array_equal(record.y[seen[:, 3], 3], 3.0 + wave(record.meta["t0"] + record.t[seen[:, 3]]))
    for j in range(3):
        expected = 3.0 + wave(record.meta["t0"] + record.t[seen[:, j]])
        # The mean of a sine over 0.1 s is 0.1 % smaller, and the samples of a block are not quite symmetrical.
        np.testing.assert_allclose(record.y[seen[:, j], j], expected, atol=0.006)
        assert np.mean(record.y[seen[:, j], j] - expected) == pytest.approx(0.0, abs=1e-4)


def test_noise_of_means_at_the_times_of_another_sensor_is_white() -> None:
    """The straight line through a block and its neighbours adds little noise, and correlates the means little."""
    t, rng = jittered(20.0, 1, 500.0), np.random.default_rng(2)
    fix = jittered(5.0, 3, 500.0)
    signals = channels() | {"psi": Channel(t, 0.1 * rng.normal(size=t.size)), "a": Channel(fix, 0.0 * fix)}
    record = build_record(model(), signals | {"b": signals["a"], "w": Channel(np.array([0.0, 499.0]), np.zeros(2))})
    psi = record.y[np.isfinite(record.y[:, 0]), 0]
    assert psi.std() == pytest.approx(0.1 / np.sqrt(2), rel=0.1)
    assert abs(np.corrcoef(psi[1:], psi[:-1])[0, 1]) < 0.15


def test_lone_sample_of_a_fast_sensor_keeps_its_own_time() -> None:
    psi = channel(50.0)
    alone = (psi.t < 3.0) | (psi.t > 5.0) | (np.abs(psi.t - 4.04) < 1e-6)
    signals = channels() | {"psi": replace(psi, t=psi.t[alone], value=psi.value[alone])}
    record = build_record(model(), signals)
    at = int(np.argmin(np.abs(record.t - 4.04)))
    assert (record.t[at], record.y[at, 0]) == pytest.approx((4.04, np.sin(4.04)), abs=1e-9)
    assert np.isnan(record.y[(record.t > 3.1) & (record.t < 4.9) & (np.arange(record.n_rows) != at), 0]).all()


def test_fast_sensor_without_averaging_has_one_sample_in_each_row() -> None:
    """The sample is the one next to the middle of its block. A block without samples has none. A slow sensor keeps its
    times.
    """
    psi = channel(25.0, f=np.exp)
    gap = (psi.t > 3.0) & (psi.t < 4.0)
    at = channels() | {"psi": replace(psi, t=psi.t[~gap], value=psi.value[~gap])}
    sampled = replace(model(), sensors=tuple(replace(s, averaged=False) for s in model().sensors))
    record, mean = (build_record(m, at, rate=10.0) for m in (sampled, model()))
    seen = np.isfinite(record.y[:, 0])
    t = record.t[seen]
    np.testing.assert_array_equal(record.y[seen, 0], np.exp(t))
    assert np.isin(np.round(t, 6), np.round(at["psi"].t, 6)).all()
    assert seen.sum() == 91
    assert np.unique(np.floor(10 * t + 1e-9)).size == 91
    np.testing.assert_array_equal(record.y[np.isfinite(record.y[:, 1]), 1:], mean.y[np.isfinite(mean.y[:, 1]), 1:])


def test_noise_of_a_block_mean_falls_with_the_root_of_its_size() -> None:
    noisy = channels() | {"psi": channel(200.0, f=lambda t: 0.1 * np.random.default_rng(1).normal(size=t.size))}
    record = build_record(model(), noisy, rate=10.0)
    psi = record.y[np.isfinite(record.y[:, 0]), 0]
    assert psi.std() == pytest.approx(0.1 / np.sqrt(20), rel=0.2)


@pytest.mark.parametrize(("rate", "length"), [(5.0, 0.1), (2.0, 0.25), (10.0, 0.1)])
def test_mean_of_slow_rows_is_over_the_middle_of_their_blocks(rate: float, length: float) -> None:
    """The mean of a parabola is larger than its value by the variance of time, which grows with the mean's length."""
    w = channel(rate)
    fast = channels() | {"psi": channel(1000.0, f=np.square), "a": w, "b": w, "w": w}
    record = build_record(model(), fast, rate=rate)
    seen = np.isfinite(record.y[:, 0])
    excess = (record.y[seen, 0] - record.t[seen] ** 2)[3:-3]
    np.testing.assert_allclose(excess, length**2 / 12, rtol=0.1)


def test_slow_block_without_samples_in_its_middle_has_the_nearest_one() -> None:
    """The samples of a block are 0.07 s before its middle, and 0.08 s and more after it."""
    before = np.arange(0.0, 9.6, 0.2) + 0.13
    t = np.sort(np.concatenate([before, *(before + after for after in (0.15, 0.155, 0.16))]))
    step = Channel(t, np.where(np.isin(t, before), 1.0, 5.0))
    w = channel(5.0)
    record = build_record(model(), {"psi": step, "a": w, "b": w, "w": w}, rate=5.0, t_from=0.0)
    np.testing.assert_allclose(record.t[np.isfinite(record.y[:, 0])], before + 0.07, atol=1e-9)
    assert step.value.mean() == 4.0
    # The line through the nearest sample and its neighbours, 0.05 s before and 0.15 s after it, adds -0.3.
    np.testing.assert_allclose(record.y[np.isfinite(record.y[:, 0]), 0][1:], 1.0, atol=0.4)


def test_mean_of_an_angle_ignores_the_wrap_and_a_missing_sample() -> None:
    """A missing angle costs only its own sample."""
    psi = channel(50.0, f=lambda t: np.mod(3.0 + t + np.pi, 2 * np.pi) - np.pi)
    value = np.where(np.arange(psi.t.size) == 33, np.nan, psi.value)
    record = build_record(model(), channels() | {"psi": replace(psi, value=value)})
    seen = np.isfinite(record.y[:, 0])
    assert seen.sum() == 121
    np.testing.assert_allclose(record.y[seen, 0], 3.0 + record.t[seen], atol=1e-9)


def test_blocks_without_known_samples_have_no_mean() -> None:
    t = np.arange(0.0, 1.0, 0.01)
    edges = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 3.0])
    found = block_mean(Channel(t, np.where(t < 0.1, np.nan, t)), edges)
    np.testing.assert_allclose(found, [np.nan, 0.145, 0.245, 0.645, np.nan])


@pytest.mark.parametrize("averaged", [True, False])
def test_gap_of_ten_years_is_rejected_at_once(averaged: bool) -> None:
    """The times are checked first, because blocks and rows over the gap would need gigabytes."""
    signals = {
        name: Channel(np.concatenate([c.t, c.t + 3.2e8]), np.tile(c.value, 2)) for name, c in channels(50.0).items()
    }
    boat = model()
    sensors = tuple(replace(sensor, averaged=averaged) for sensor in boat.sensors)
    with pytest.raises(ValueError, match=r"no sensor has a sample from .* too long for a record; use only the part"):
        build_record(replace(boat, sensors=sensors), signals)


def test_rows_are_at_all_times_and_no_interval_is_long() -> None:
    sparse = channels() | {"psi": Channel(np.array([0.0, 3.0, 10.0]), np.zeros(3))}
    record = build_record(model(), sparse, rate=10.0, max_step=0.1)
    assert (np.diff(record.t) > 1e-6).all()
    assert np.diff(record.t).max() <= 1.1 * 0.1 + 1e-9
    for t in (0.0, 2.04, 3.0, 5.0, 7.25, 10.0):
        assert np.abs(record.t - t).min() < 1e-9
    assert np.isfinite(record.y[:, 0]).sum() == 3
    coarse = build_record(model(), sparse, rate=10.0, max_step=5.0)
    assert np.diff(coarse.t).max() == pytest.approx(0.25)
    assert record.h[-1] == 0.0
    np.testing.assert_allclose(np.cumsum(record.h)[:-1], record.t[1:])


def test_irregular_samples_create_no_rows_without_samples() -> None:
    """Because of clock jitter, every other interval of a sensor at 10 Hz is longer than 0.1 s."""
    late = np.random.default_rng(4).uniform(0.0, 0.009, 101)
    t = np.arange(101) / 10 + late
    record = build_record(model(), channels() | {"psi": Channel(t, np.sin(t))}, rate=10.0, max_step=0.1)
    rows = record.t[~np.isfinite(record.y).any(axis=1)]
    # Only the input has changes at these rows.
    np.testing.assert_allclose(rows, [2.04, 10.0 - record.meta["t0"]][: rows.size], atol=0.01)


def test_zero_hold_switches_at_its_own_times_and_a_linear_hold_interpolates() -> None:
    record = build_record(model(), channels() | {"psi": channel(5.0)})  # No sensor is averaged.
    switch = int(np.argmin(np.abs(record.t - 2.04)))
    assert record.t[switch] == pytest.approx(2.04)
    assert (record.u[switch - 1, 0], record.u_next[switch - 1, 0], record.u[switch, 0]) == (1.0, 1.0, -2.0)
    np.testing.assert_array_equal(record.u, record.u_next)
    w = channels()["w"]
    linear = build_record(model("linear"), channels() | {"psi": channel(5.0)})
    np.testing.assert_allclose(linear.u[:, 0], np.interp(linear.t, w.t, w.value), atol=1e-12)
    corner = int(np.searchsorted(linear.t, 2.04)) - 1
    smooth = np.delete(np.arange(linear.n_rows - 1), corner)
    np.testing.assert_allclose(linear.u_next[smooth], linear.u[smooth + 1], atol=1e-9)


def impulse(record: Record) -> float:
    """Return the integral of the first input, as a Runge-Kutta step integrates its line."""
    return float(np.sum(record.h * (record.u[:, 0] + record.u_next[:, 0]) / 2))


def test_integral_of_a_linear_input_is_preserved() -> None:
    rng = np.random.default_rng(3)
    for psi in (5.0, 50.0):  # Without averaging, and with averaging.
        value = np.pad(rng.normal(size=401), 50)
        signals = channels() | {"w": Channel(np.arange(0.0, 10.001, 0.02), value), "psi": channel(psi)}
        assert impulse(build_record(model("linear", "psi"), signals)) == pytest.approx(0.02 * value.sum(), abs=1e-6)


@pytest.mark.parametrize("hold", ["linear", "average", "zero"])
def test_input_is_averaged_like_the_fast_sensors(hold: str) -> None:
    """If force and acceleration pass through the same filter, their relation does not change."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 10.001, 0.0005)
    # The force has steps every 0.07 s, and a sensor at 2 kHz measures it.
    force = np.repeat(rng.uniform(-1.0, 1.0, 150), 140)[: t.size]
    signals = channels() | {"psi": Channel(t, force), "w": Channel(t[::140], force[::140])}
    if hold == "linear":
        signals["w"] = Channel(t, force)
    record = build_record(model(hold, "psi"), signals)
    seen = np.isfinite(record.y[:, 0]) & (record.t > 0.1) & (record.t < 9.8)  # the block at the end is longer
    np.testing.assert_allclose(record.u[seen, 0], record.y[seen, 0], atol=0.04)
    raw = replace(model(hold, "psi"), inputs=(Input("w", "N", hold, prefilter=False),))  # type: ignore[arg-type]
    # The input is not averaged if the output that contains it is not averaged, or if no output contains it.
    for unaveraged in (raw, model(hold, "a"), model(hold)):
        sharp = build_record(unaveraged, signals)
        seen = np.isfinite(sharp.y[:, 0])
        assert np.abs(sharp.u[seen, 0] - sharp.y[seen, 0]).max() > 0.5


def test_input_before_the_part_has_no_influence() -> None:
    """This also holds if the input is unknown there."""
    for hold in ("linear", "zero"):
        known = channels() | {"w": channel(50.0)}
        value = known["w"].value.copy()
        value[3] = np.nan
        unknown = known | {"w": Channel(known["w"].t, value)}
        rows = [build_record(model(hold, "psi"), signals, t_from=2.0) for signals in (known, unknown)]
        np.testing.assert_array_equal(rows[0].u, rows[1].u)


def test_delayed_input_in_the_data_is_used() -> None:
    copies = replace(with_taps(0, 2), name="copies")
    signals = channels() | {"g~2": channel(50.0, f=lambda t: np.full(t.size, 7.0)), "g": channel(50.0)}
    record = build_record(copies, signals)
    assert (record.u[:, list(record.inputs).index("g~2")] == 7.0).all()


def test_repeated_command_creates_no_row() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    repeated = channels() | {"w": Channel(t, np.where(t < 2.04, 1.0, np.where(t < 5.0, -2.0, 3.0)))}
    for psi in (5.0, 50.0):  # Without averaging, and with averaging.
        slow = {"psi": channel(psi)}
        record, sparse = (build_record(model(feels="psi"), signals | slow) for signals in (repeated, channels()))
        assert record.n_rows <= sparse.n_rows + 1
        assert sparse.n_rows < 0.4 * t.size
        same = slice(0, sparse.n_rows - 3)
        np.testing.assert_allclose(record.u[same], sparse.u[same], atol=1e-12)


def test_line_between_rows_has_the_mean_and_first_moment_of_the_held_input() -> None:
    rng = np.random.default_rng(1)
    held = Channel(np.sort(rng.uniform(-0.5, 10.0, 300)), rng.normal(size=300))
    t = np.append(np.arange(0.0, 10.0, 0.1), 10.5)
    start, end = held_lines(held, t)
    fine = np.arange(0.0, 10.5, 1e-5) + 0.5e-5
    value, row = sample_and_hold(held, fine), np.searchsorted(t, fine) - 1
    h, since = np.diff(t), fine - t[row]
    mean, moment = (np.bincount(row, x) * 1e-5 for x in (value, value * since))
    np.testing.assert_allclose((start + end)[:-1] / 2 * h, mean, atol=1e-4)
    np.testing.assert_allclose((start / 2 + (end - start) / 3)[:-1] * h**2, moment, atol=1e-5)
    still = Channel(np.array([-1.0, 20.0]), np.array([0.3, 0.7]))
    np.testing.assert_allclose(held_lines(still, t), 0.3, atol=1e-12)


def test_delayed_input_is_averaged_like_its_signal() -> None:
    own = replace(with_taps(0), inputs=(Input("g", "", "linear", prefilter=False),))
    late = Effect("late", "late", {}, inputs=(Input("g", "", "linear").delayed(1), Input("h")))
    assert [i.prefilter for i in (own + late).inputs] == [False, False, True]


def test_delayed_input_is_held_like_its_signal() -> None:
    """The hold that an effect declares is ignored. With a linear hold, a held command would begin to rise too early."""
    zero = replace(with_taps(0), inputs=(Input("g", "", "zero"),))
    taps = Effect("late", "late", {}, inputs=tuple(Input("g", "", "linear").delayed(k) for k in (1, 2)))
    assert [i.hold for i in (zero + taps).inputs] == ["zero", "average", "average"]
    assert [i.hold for i in (with_taps(0) + taps).inputs[-2:]] == ["linear", "linear"]


def test_switch_just_after_a_sample_is_at_the_same_row() -> None:
    """Equal times may differ by rounding, because seconds since 1970 have steps of 0.24 us. They form one row."""
    signals = channels() | {"w": Channel(np.array([0.0, 2.0 + 5e-8, 10.0]), np.array([1.0, -2.0, 3.0]))}
    signals |= {"a": channel(10.0), "b": channel(10.0), "psi": channel(5.0)}
    record = build_record(model(), signals)
    row = int(np.argmin(np.abs(record.t - 2.0)))
    assert record.t[row] == pytest.approx(2.0, abs=1e-6)
    assert record.u[row, 0] == -2.0


def test_sample_and_hold_uses_the_first_value_before_the_first_sample() -> None:
    c = Channel(np.array([1.0, 2.0, 2.0, 3.0]), np.array([5.0, 6.0, 7.0, 8.0]))
    np.testing.assert_array_equal(sample_and_hold(c, np.array([0.0, 1.0, 1.99, 2.0, 2.5, 9.0])), [5, 5, 5, 7, 7, 8])


def test_common_time_is_used_unless_a_part_is_requested() -> None:
    late = channels() | {"a": channel(4.0, 6.0, 1.5), "b": channel(4.0, 6.0, 1.5)}
    record = build_record(model(), late)
    assert record.meta["t0"] == 1.5
    assert record.duration == pytest.approx(6.0)
    assert record.t[0] == 0.0
    assert record.u[0, 0] == pytest.approx(1.0)
    part = build_record(model(), late, t_from=3.0, t_to=5.0, name="part", meta={"why": "asked"})
    assert (part.name, part.meta["why"], part.meta["t0"]) == ("part", "asked", 3.0)
    assert part.duration == pytest.approx(2.0)
    assert part.u[0, 0] == pytest.approx(-2.0)


@pytest.mark.parametrize(
    ("at", "end"),
    [
        ([0.0, 2.0, 6.0], 10.0),  # The command is recorded on change, so its last value holds.
        ([0.0, 2.0, 2.5], 2.5),  # No earlier value was held for so long.
        (np.arange(0.0, 5.0, 0.1), 4.9),  # The command is recorded regularly, so its source has failed.
    ],
)
def test_command_recorded_on_change_is_held_to_the_end(at: Sequence[float], end: float) -> None:
    w = Channel(np.array(at), np.ones(len(at)))
    record = build_record(model(), channels() | {"w": w}, rate=10.0)
    assert record.t[-1] == pytest.approx(end)
    if end < 10.0:
        name, lost = record.meta["cut"]
        assert (name, lost) == ("w", pytest.approx(10.0 - end))
        (warning,) = cut_records([record])
        assert (warning.code, "w ends" in warning.text) == ("record-cut", True)
    else:
        assert "cut" not in record.meta


def test_delayed_input_is_the_input_some_steps_ago() -> None:
    wide = with_taps(0, 1, 7)
    ramp = channels() | {"g": channel(50.0, f=lambda t: 2.0 * t)}
    record = build_record(wide, ramp)
    names = list(record.inputs)
    now, one_step, seven_steps = (record.u[:, names.index(n)] for n in ("g", "g~1", "g~7"))
    later = record.t > 7 * HISTORY_STEP
    np.testing.assert_allclose(now[later] - one_step[later], 2.0 * HISTORY_STEP, atol=1e-9)
    np.testing.assert_allclose(now[later] - seven_steps[later], 14.0 * HISTORY_STEP, atol=1e-9)
    assert seven_steps[0] == now[0]  # Before the first sample, the first value is used.
    assert record.duration == pytest.approx(10.0)  # The delayed inputs do not shorten the record.


def test_time_and_work_are_computed_as_inputs() -> None:
    wide = with_inputs("t", "n_left", "n_right", "work")
    shafts = {"n_left": channel(25.0, f=lambda t: np.full(t.size, 0.5)), "n_right": channel(25.0, f=lambda t: -t / 10)}
    record = build_record(wide, channels() | shafts, t_from=2.0)
    t, work = (record.u[:, list(record.inputs).index(n)] for n in ("t", "work"))
    np.testing.assert_allclose(t, record.t)
    # Work counts from the start of the log, because a battery discharges before the fitted part as well.
    at = record.t + 2.0
    np.testing.assert_allclose(work, (0.125 * at + at**4 / 4000) / WORK_UNIT, atol=1e-5)


def test_missing_sensor_is_left_out_and_reported() -> None:
    record = build_record(model(), {n: c for n, c in channels().items() if n != "b"})
    assert record.meta["missing"] == ("pair",)
    assert not np.isfinite(record.y[:, 1:]).any()
    assert np.isfinite(record.y[:, 0]).any()


@pytest.mark.parametrize(
    ("drop", "change", "message"),
    [
        (
            ("w",),
            {},
            "run 7: no signal for the input 'w' of model cart; the log has a, b, psi; use another model, or a log with "
            "this signal",
        ),
        (
            ("psi", "a"),
            {},
            "run 7: none of the sensors of model cart is in the log; it needs one of compass, pair; use another model, "
            "or a log with such a sensor",
        ),
        (
            (),
            {"w": channel(1.0, 10.0, 20.0)},
            "run 7: inputs and sensors overlap for only 0.00 s, and 0.2 s are needed: check the time stamps, or use "
            "a longer part of the log",
        ),
        (
            (),
            {"b": channel(4.0, 9.0, 0.1)},
            "run 7: a and b are used together as the sensor pair, but they have no common time stamp; give both the "
            "same time stamps",
        ),
    ],
)
def test_impossible_record_gives_a_one_line_error(
    drop: tuple[str, ...], change: dict[str, Channel], message: str
) -> None:
    signals = {n: c for n, c in channels().items() if n not in drop} | change
    with pytest.raises(ValueError, match="run 7") as problem:
        build_record(model(), signals, name="run 7")
    assert str(problem.value) == message


def test_record_can_be_reduced_to_other_models_and_parts() -> None:
    wide = with_taps(0, 3)
    record = build_record(wide, channels() | {"g": channel(50.0)})
    own = record.for_model(model())
    assert (own.inputs, own.outputs) == (("w",), ("psi", "a", "b"))
    np.testing.assert_array_equal(own.u[:, 0], record.u[:, 0])
    assert np.shares_memory(own.u, record.u)  # A search keeps records for dozens of models.
    assert own.y is record.y
    fewer = replace(model(), sensors=model().sensors[1:])
    np.testing.assert_array_equal(record.for_model(fewer).y, record.y[:, 1:])
    with pytest.raises(ValueError, match="no signal for the input 'g' of model cart"):
        own.for_model(wide)
    part = record.part(2.0, 4.0)
    assert part.name == "record[2:4]"
    assert (part.t[0] >= 2.0, part.t[-1] < 4.0, part.n_rows) == (True, True, part.y.shape[0])
    assert isinstance(part, Record)


def test_row_of_a_sensor_has_all_its_outputs_at_the_same_time() -> None:
    """An import drops NaN separately for each signal, so two outputs can have different times."""
    found = channels()
    for name, lost in (("a", 10), ("b", 20)):
        c = found[name]
        found[name] = Channel(np.delete(c.t, lost), np.delete(c.value, lost))
    record = build_record(model(), found, rate=10.0)
    pair = record.y[:, 1:]
    whole = np.isfinite(pair).all(axis=1)
    np.testing.assert_array_equal(np.isfinite(pair).any(axis=1), whole)
    t = record.t[whole]
    np.testing.assert_allclose(t, np.delete(np.arange(0, 10.01, 0.25), [10, 20]), atol=1e-9)
    np.testing.assert_allclose(pair[whole], np.column_stack([np.sin(t), np.cos(t)]))


@pytest.mark.parametrize("hold", ["average", "zero"])
def test_given_inputs_never_exceed_the_samples(hold: str) -> None:
    """The line of an averaged input overshoots a step; what is shown as given does not."""
    t = np.arange(0.0, 10.0, 0.27)
    command = np.where(np.arange(t.size) % 8 < 4, 0.8, -0.5)
    signals = {n: channel(10.0) for n in ("psi", "a", "b")} | {"w": Channel(t, command)}
    held = model(hold)
    record = build_record(held, signals, rate=5.0)
    given = given_inputs(held, record)
    assert given.shape == record.u.shape
    assert (given.min(), given.max()) == pytest.approx((-0.5, 0.8), abs=1e-12)
    if hold == "average":
        assert record.u.max() > 0.9
        assert np.sum(given[:-1, 0] * record.h[:-1]) == pytest.approx(
            np.sum((record.u + record.u_next)[:-1, 0] * record.h[:-1]) / 2.0
        )
    else:
        np.testing.assert_array_equal(given, record.u)
