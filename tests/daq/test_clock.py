"""Tests of the run clock, and of the map of device clocks to it with known skew and delays."""

from __future__ import annotations

import math
import subprocess
import sys
import time

import numpy as np
import pytest

from seatrial.daq.clock import ClockMap, RunClock


def test_the_run_clock_starts_at_the_wall_clock_and_runs_at_its_speed() -> None:
    clock = RunClock(speed=50.0)
    assert abs(clock.now() - time.time()) < 5.0
    before, wall = clock.now(), time.monotonic()
    clock.sleep_until(before + 2.5)
    passed = time.monotonic() - wall
    assert passed >= clock.wall(2.5) - 1e-3
    assert clock.now() >= before + 2.5
    assert clock.now() - before == pytest.approx(50.0 * (time.monotonic() - wall), rel=0.2)
    clock.sleep_until(before)  # this time has passed, so the call returns at once


def test_another_process_with_the_same_origin_agrees() -> None:
    clock = RunClock(speed=3.0)
    code = f"from seatrial.daq.clock import RunClock; print(RunClock({clock.speed!r}, {clock.origin!r}).now())"
    before = clock.now()
    there = float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True).stdout)
    assert before < there < clock.now()


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_an_invalid_clock_speed_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        RunClock(speed)


def run_map(skew: float, delays: np.ndarray, rate: float = 200.0) -> tuple[np.ndarray, np.ndarray, ClockMap]:
    """Return the errors of the estimate [s], the receive times, and the map, for a device clock with this skew."""
    truth = 1.7e9 + np.arange(len(delays)) / rate
    device = 12.5 + (truth - 1.7e9) * (1.0 - skew)
    clock_map = ClockMap()
    received = np.maximum.accumulate(truth + delays)
    estimates = np.array([clock_map.update(d, r) for d, r in zip(device, received, strict=True)])
    assert np.all(estimates <= received)
    assert np.all(np.diff(estimates) >= 0)
    return estimates - truth, received - truth, clock_map


def test_the_latency_of_a_usb_adapter_is_removed() -> None:
    rng = np.random.default_rng(1)
    n = 60_000  # 300 s at 200 Hz
    # The adapter delivers its data every 16 ms.
    truth = np.arange(n) / 200.0
    delays = np.ceil(truth / 0.016) * 0.016 - truth + rng.exponential(50e-6, n)
    errors, arrival, clock_map = run_map(30e-6, delays)
    settled = errors[2000:]
    assert abs(arrival[2000:].mean()) > 7e-3  # the error of the arrival time
    assert abs(settled.mean()) < 150e-6
    assert settled.std() < 100e-6
    assert clock_map.bias == pytest.approx(arrival.mean(), abs=1e-3)
    assert clock_map.resets == 0


@pytest.mark.parametrize("skew", [-100e-6, 0.0, 100e-6])
def test_skew_is_followed(skew: float) -> None:
    rng = np.random.default_rng(2)
    errors, _, _ = run_map(skew, 1e-4 + rng.exponential(2e-3, 40_000))
    assert np.max(np.abs(errors[4000:])) < 1e-3


def test_from_the_first_sample_on_the_map_is_no_worse_than_the_arrival_time() -> None:
    rng = np.random.default_rng(3)
    errors, arrival, _ = run_map(30e-6, rng.uniform(0.0, 0.016, 400))
    assert np.all(errors <= arrival)
    assert np.all(errors > -2e-3)


def test_a_device_that_restarts_starts_a_new_map() -> None:
    clock_map = ClockMap()
    for k in range(100):
        clock_map.update(500.0 + 0.01 * k, 1000.0 + 0.01 * k)
    for k in range(100):
        assert clock_map.update(0.01 * k, 1010.0 + 0.01 * k) == pytest.approx(1010.0 + 0.01 * k, abs=1e-6)
    assert clock_map.resets == 1


@pytest.mark.parametrize("jump", [3600.0, 2.0])
def test_the_map_follows_a_clock_that_is_set_forward_or_stood_still(jump: float) -> None:
    forward, behind = ClockMap(), ClockMap()
    for k in range(3000):
        t = 0.02 * k
        late = jump if k > 1000 else 0.0
        ahead = forward.update(t + late, 1000.0 + t)
        slow = behind.update(t, 1000.0 + t + late)
    assert ahead == pytest.approx(1000.0 + t, abs=0.02)
    assert slow == pytest.approx(1000.0 + t + jump, abs=0.02)
    assert forward.resets == behind.resets == 1


STEPS = [(step, rate) for step in (-0.3, -0.6, -0.9, -1.0) for rate in (1.0, 5.0, 50.0)]


@pytest.mark.parametrize(("step", "rate"), STEPS[1:])  # a link with a queue can also delay messages by 0.3 s at 1 Hz
def test_the_map_follows_a_clock_that_is_set_back_by_less_than_a_second(step: float, rate: float) -> None:
    rng, clock_map, off = np.random.default_rng(4), ClockMap(), []
    for k in range(int(150 * rate)):
        t = 1000.0 + k / rate
        t_rx = t + rng.uniform(0.06, 0.09)
        estimate = clock_map.estimate(1.7e9 + t + (step if t >= 1060.0 else 0.0), t_rx, unordered=True, kind="fix")
        assert t_rx - estimate < 0.05 or t < 1060.0 + ClockMap.LATER_FOR + 2.0 / rate + 1.0
        off.append(t_rx - estimate > 0.05)
    assert clock_map.resets == 1
    # A step back is recognised a second later. A step shorter than the period is recognised because it persists.
    runs_back = ClockMap.AGAIN_FOR + (ClockMap.AGAIN_N + 1) / rate
    assert sum(off) / rate <= (ClockMap.LATER_FOR + 2.0 if -step <= 1.0 / rate else runs_back)


def test_a_step_is_recognised_between_samples_of_other_kinds() -> None:
    clock_map, rng = ClockMap(), np.random.default_rng(5)
    late = []
    for k in range(100 * 50):
        t = 0.02 * k
        at = 500.0 + t - (0.6 if t >= 60.0 else 0.0)
        clock_map.estimate(at, t + rng.uniform(0.001, 0.003), True, "attitude")
        if k % 10 == 0:  # a fix is older than the attitude before it
            late.append(t + 0.003 - clock_map.estimate(at - 0.15, t + 0.003, True, "fix"))
    assert clock_map.resets == 1
    known = [at for k, at in enumerate(late) if not 300 <= k <= 306]  # a second after the step
    assert known == pytest.approx([0.15] * len(known), abs=0.01)


def test_reordered_packets_are_not_a_clock_step() -> None:
    rng, clock_map = np.random.default_rng(6), ClockMap()
    order = np.arange(20_000)
    for at in range(100, 19_900, 100):
        order[[at, at + 1]] = order[[at + 1, at]]
    for k, of in enumerate(order):
        clock_map.estimate(0.1 * of, 1000.0 + 0.1 * max(k, of) + rng.uniform(0.001, 0.02), True, "attitude")
    assert clock_map.resets == 0


@pytest.mark.parametrize("jitter", [0.02, 0.05])
def test_a_busy_link_with_several_samples_per_message_is_not_a_clock_step(jitter: float) -> None:
    """Each message is late by an exponential time.

    Sometimes a queue drains, and sometimes a packet is overtaken. Each message reports two outputs at one time.
    """
    rng, clock_map, ready, off = np.random.default_rng(7), ClockMap(), 0.0, []
    sent = 0.1 * np.arange(12_000) + rng.uniform(0.0, 0.002, 12_000)
    came = sent + 0.003 + rng.exponential(jitter, sent.size) + 0.15 * (sent % 20.0 < 0.5)
    for t, at in sorted(zip(sent, came, strict=True), key=lambda both: both[1]):
        ready = max(at, ready)
        for _ in "two":
            off.append(clock_map.estimate(500.0 + t, 1000.0 + ready, True, "servo") - 1000.0 - t)
    assert clock_map.resets == 0
    assert np.abs(off[200:]).max() < 0.02


def test_a_time_that_is_repeated_for_a_while_is_not_a_clock_step() -> None:
    clock_map = ClockMap()
    for k in range(500):
        t = 0.2 * k
        clock_map.estimate(10.0 if 10.0 < t < 15.0 else t, t + 0.05, True, "fix")
    assert clock_map.resets == 0
    for k in range(500, 800):  # the repetition does not end
        clock_map.estimate(99.8, 0.2 * k + 0.05, True, "fix")
    assert 1 <= clock_map.resets <= 6


def test_a_link_that_starts_slowly_is_not_a_clock_step() -> None:
    clock_map = ClockMap()
    for k in range(3000):
        t, queued = 0.02 * k, 0.4 if k < 100 else 0.0  # bytes that the host had buffered before the port was read
        clock_map.estimate(t, 1000.0 + t + queued + 0.002, True, "attitude")
        clock_map.estimate(t - 0.3, 1000.0 + t + queued + 0.003, True, "fix")
    assert clock_map.resets == 0


@pytest.mark.skipif(not hasattr(time, "CLOCK_MONOTONIC_RAW"), reason="a system without a raw clock")
def test_a_host_clock_that_is_slewed_does_not_reach_run_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, raw, plain = RunClock(), time.CLOCK_MONOTONIC_RAW, time.clock_gettime
    monkeypatch.setattr(time, "monotonic", lambda: 1.08 * plain(time.CLOCK_MONOTONIC))  # chrony slews in this way
    before, from_raw = clock.now(), plain(raw)
    time.sleep(0.2)
    assert clock.now() - before == pytest.approx(plain(raw) - from_raw, abs=0.01)


def test_a_pause_of_the_reader_is_not_a_clock_step() -> None:
    clock_map = ClockMap()
    estimates = [clock_map.update(0.01 * k, 1000.0 + max(0.01 * k, 5.0 if 300 < k < 500 else 0.0)) for k in range(2000)]
    assert clock_map.resets == 0
    assert estimates == pytest.approx([1000.0 + 0.01 * k for k in range(2000)], abs=1e-6)


def test_without_a_device_time_the_receive_time_is_used() -> None:
    clock_map = ClockMap()
    assert clock_map.update(math.nan, 7.0) == 7.0
    assert math.isnan(clock_map.bias)
