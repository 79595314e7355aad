"""Tests of mock devices: their bytes are read by our decoders, their ESCs follow commands, and their faults occur."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.clock import ClockMap
from seatrial.daq.config.rig_file import load_rig, parse_rig
from seatrial.daq.drivers.base import LinkRole
from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import loadcell, nmea, slcan, vectornav, vesc
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Ahrs, Battery, Esc, Frame, Gnss, LoadCell, Sample
from seatrial.mocks.cli import _device_specs
from seatrial.mocks.devices.emulators import VescBus, by_side, make_emulator
from seatrial.mocks.devices.faults import Faults, parse_fault
from seatrial.mocks.devices.slcan_adapter import CanFrame
from seatrial.mocks.plant.bench import draw_bench
from seatrial.mocks.plant.boat import draw_boat
from seatrial.mocks.sensors import EscSensor
from seatrial.mocks.world import EscController, EscSpec, World, bench_world, boat_world
from tests.daq.mavlink_ends import Ends, mav_rig


def packaged(name: str, **changes: str) -> Rig:
    text = (files("seatrial.mocks") / "rigs" / f"{name}.toml").read_text(encoding="utf-8")
    for old, new in changes.items():
        text = text.replace(old, new)
    return parse_rig(text, Path("/nowhere/rig.toml"))


def sent_bytes(rig: Rig, world: World, seconds: float) -> dict[str, bytes]:
    """Return the bytes that each device sends in `seconds`. The CAN channel is open from the start."""
    speakers = {}
    for device in rig.devices:
        nodes = {c.spec.node: c for c in world.controllers if c.spec.device == device.name}
        speakers[device.name] = make_emulator(rig, device, nodes)
        speakers[device.name].receive(b"S6\rO\r", 0.0)
    sent = dict.fromkeys(speakers, b"")
    while world.t < seconds:
        for device_name, sample, t in world.readings():
            sent[device_name] += speakers[device_name].encode(sample, t)
        world.advance()
    return sent


def esc_frames(data: bytes) -> list[Frame]:
    decoder = vesc.Decoder({1: 7, 2: 7})
    raw = b"".join(f if isinstance(f, bytes) else f.sample for f in slcan.Decoder().feed(data, 0.0))
    return decoder.feed(raw, 0.0)


def test_the_packaged_rigs_are_valid(tmp_path: Path) -> None:
    for name in ("boat", "bench"):
        text = (files("seatrial.mocks") / "rigs" / f"{name}.toml").read_text(encoding="utf-8")
        (tmp_path / "rig.toml").write_text(text)
        assert load_rig(tmp_path / "rig.toml").speed == 20.0


def test_the_decoders_read_the_bytes_of_the_mock_boat() -> None:
    rig = packaged("boat")
    world = boat_world(draw_boat(1), 0, _device_specs(rig, by_side(rig)), utc=1.7e9)
    world.controllers[0].command(0.0, 0.6)
    sent = sent_bytes(rig, world, 4.0)

    ahrs = vectornav.Decoder()
    frames = ahrs.feed(sent["ahrs"], 0.0)
    assert (len(frames), ahrs.checksum_errors, ahrs.unparsed_bytes) == (200, 0, 0)
    assert all(isinstance(f.sample, Ahrs) and math.isfinite(f.sample.mx) for f in frames)
    assert np.allclose([f.t_device for f in frames], 0.02 * np.arange(200))

    gnss = nmea.Decoder()
    fixes = [f.sample for f in gnss.feed(sent["gnss"], 0.0) + gnss.flush()]
    assert (gnss.checksum_errors, gnss.unparsed_bytes) == (0, 0)
    assert [f.utc for f in fixes if isinstance(f, Gnss)] == pytest.approx(1.7e9 + 0.2 * np.arange(20), abs=1e-3)
    assert all(isinstance(f, Gnss) and f.fix == 6 and abs(f.lat - 38.7658) < 1e-3 for f in fixes)

    escs = [f.sample for f in esc_frames(sent["esc"])]
    assert [e.node for e in escs[:4] if isinstance(e, Esc)] == [1, 2, 1, 2]
    assert len(escs) == 200
    last = [e for e in escs if isinstance(e, Esc) and e.node == 1][-1]
    assert last.rpm == pytest.approx(2700.0, abs=30.0)
    assert (last.duty, last.voltage) == pytest.approx((0.6, 16.2), abs=0.3)
    assert last.temperature == pytest.approx(24.0, abs=2.0)


def test_the_decoders_read_the_bytes_of_the_mock_bench() -> None:
    rig = packaged("bench")
    bench = draw_bench(1)
    world = bench_world(bench, 0, _device_specs(rig, rig.thrusters))
    world.controllers[0].command(0.0, 0.8)
    sent = sent_bytes(rig, world, 4.0)
    cell = rig.device("loadcell")
    assert cell.calibration is not None
    decoder = loadcell.Decoder(cell.pattern, cell.saturation, cell.calibration.force)
    readings = [f.sample for f in decoder.feed(sent["loadcell"], 0.0)]
    assert (len(readings), decoder.unparsed_bytes) == (320, 0)
    force = np.mean([r.force for r in readings[200:] if isinstance(r, LoadCell)])
    assert force == pytest.approx(0.64 * (bench.thruster.c1 + bench.thruster.c2), abs=1.5)
    assert len(esc_frames(sent["esc"])) == 200


def test_vnymr_on_request() -> None:
    rig = packaged("boat")
    world = boat_world(draw_boat(1), 0, _device_specs(rig, by_side(rig)))
    sample = world.readings()[0].sample
    line = make_emulator(rig, rig.device("ahrs"), {}, ascii_=True).encode(sample, 0.0)
    assert line.startswith(b"$VNYMR,")
    (frame,) = vectornav.Decoder().feed(line, 0.0)
    assert isinstance(sample, Ahrs)
    assert isinstance(frame.sample, Ahrs)
    assert frame.sample.yaw == pytest.approx(sample.yaw, abs=2e-5)


def duty(node: int, n: float) -> bytes:
    arbitration_id, data = vesc.encode_duty(node, n)
    return f"T{arbitration_id:08X}{len(data)}{data.hex().upper()}\r".encode()


class FakePlant:
    """Plant that keeps the commands of its shafts."""

    step_s, steps, energy = 0.005, 0, 0.0
    shafts = ()

    def __init__(self) -> None:
        self.commands: list[tuple[int, float, float]] = []

    def command(self, thruster: int, t: float, n_cmd: float) -> None:
        self.commands.append((thruster, t, n_cmd))

    def thrust(self, thruster: int) -> float:
        return 0.0

    def advance(self) -> None:
        self.steps += 1


def controllers(plant: FakePlant, reversed_: Sequence[bool] = (False, False)) -> dict[int, EscController]:
    return {
        node: EscController(EscSpec("esc", node, 25.0, reversed=back, timeout_s=1.0), plant, node - 1)
        for node, back in zip((1, 2), reversed_, strict=True)
    }


def test_commands_reach_their_node_and_time_out_on_their_own() -> None:
    plant = FakePlant()
    escs = controllers(plant)
    changes: list[tuple[float, int, float, str]] = []
    for esc in escs.values():
        esc.on_change = lambda *change: changes.append(change)
    bus = VescBus(escs, {1: 7, 2: 7})
    assert bus.receive(b"O\r" + duty(1, 0.5), 10.0) == b"\rZ\r"
    bus.receive(duty(2, -0.3), 10.2)
    bus.receive(duty(1, 0.5), 10.9)  # the same command again: no change, and no time-out
    bus.receive(duty(7, 0.5), 10.9)  # no such node
    for esc in escs.values():
        esc.check(11.5)
    assert changes == [
        (10.0, 1, pytest.approx(0.5), "command"),
        (10.2, 2, pytest.approx(-0.3), "command"),
        (pytest.approx(11.2), 2, 0.0, "timeout"),
    ]
    for esc in escs.values():
        esc.check(12.5)
    assert changes[-1] == (pytest.approx(11.9), 1, 0.0, "timeout")
    assert plant.commands[-1] == (0, pytest.approx(11.9), 0.0)
    bus.receive(duty(1, 0.2), 13.0)
    assert escs[1].n == pytest.approx(0.2)


def test_a_reversed_thruster_turns_ahead_for_a_negative_duty() -> None:
    plant = FakePlant()
    escs = controllers(plant, (True, False))
    bus = VescBus(escs, {1: 7, 2: 7})
    bus.receive(b"O\r" + duty(1, -0.5), 0.0)
    assert plant.commands == [(0, 0.0, pytest.approx(0.5))]
    assert escs[1].duty == pytest.approx(-0.5)


def test_a_command_on_a_closed_channel_is_ignored() -> None:
    plant = FakePlant()
    bus = VescBus(controllers(plant), {1: 7, 2: 7})
    assert bus.receive(duty(1, 0.5), 0.0) == b"\a"
    assert bus.receive(CanFrame(0, b"").data, 0.0) == b""
    assert plant.commands == []


def test_rigs_that_no_mock_can_serve() -> None:
    one_sided = packaged("boat", **{"[-0.55, 0.15, 0.0]": "[-0.55, -0.16, 0.0]"})
    with pytest.raises(SeatrialError, match="two thrusters"):
        by_side(one_sided)
    native = packaged("boat", **{"slcan:ports/can": "socketcan:can0"})
    with pytest.raises(SeatrialError, match="slcan:PORT"):
        make_emulator(native, native.device("esc"), {})
    odd = packaged("bench", **{r"'^(?P<counts>-?\d+)$'": r"'^W(?P<counts>\d+)$'"})
    with pytest.raises(SeatrialError, match="pattern"):
        make_emulator(odd, odd.device("loadcell"), {})


RNG = np.random.default_rng(0)
AHRS = [Ahrs(0.01 * k, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, -9.81) for k in range(100)]


def through(fault: str, device: str = "ahrs", trigger: float | None = None) -> list[float | None]:
    """Return the yaw of one sample per second after the fault, None if no sample came."""
    faults = Faults([parse_fault(fault, ("ahrs", "gnss"), ("left",))], RNG)
    out: list[float | None] = []
    for k in range(20):
        if k == trigger:
            faults.trigger(float(k))
        sample = faults.reading(device, AHRS[k], float(k))
        out.append(sample.r if isinstance(sample, Ahrs) and fault.startswith("spike") else None)
        if isinstance(sample, Ahrs) and not fault.startswith("spike"):
            out[-1] = round(100.0 * sample.yaw)
    return out


def test_faults_have_their_effect_at_their_time() -> None:
    whole = [float(k) for k in range(20)]
    assert through("silence/ahrs@5:3") == [*whole[:5], None, None, None, *whole[8:]]
    assert through("silence/gnss@5:3") == whole
    assert through("stuck@5:3") == [*whole[:5], 4.0, 4.0, 4.0, *whole[8:]]
    assert [k for k, r in enumerate(through("spike@5")) if r != 0.1] == [5]
    assert [k for k, r in enumerate(through("spike@5:2")) if r != 0.1] == [5, 6, 7]
    assert through("silence@usr1:2", trigger=7.0) == [*whole[:7], None, None, *whole[9:]]


@pytest.mark.parametrize("kind", ["hold", "stuck"])
def test_a_fault_of_a_device_with_several_kinds_of_samples_repeats_each_kind(kind: str) -> None:
    """An autopilot sends attitudes and fixes in turns."""
    faults = Faults([parse_fault(f"{kind}@5:10")], RNG)
    for k in range(12):
        ahrs = faults.reading("autopilot", AHRS[k], float(k))
        fix = faults.reading("autopilot", Gnss(float(k), 41.0 + k, -8.0, fix=3), float(k))
        assert isinstance(ahrs, Ahrs)
        assert isinstance(fix, Gnss)
        assert fix.lat == 41.0 + min(k, 4)
        assert ahrs.yaw == AHRS[min(k, 4) if kind == "stuck" else k].yaw


def test_the_clock_of_a_device_that_is_set_back_is_followed() -> None:
    """The map of each device's clock to run time has to follow a step and a skew."""
    rig = packaged("boat")
    world = boat_world(draw_boat(3), 0, _device_specs(rig, by_side(rig)), utc=1.8e9)
    texts = ("clock-back/gnss@20", "clock-back/ahrs@20", "clock-skew@0")
    faults = Faults([parse_fault(text, ("ahrs", "gnss")) for text in texts], RNG)
    speakers = {name: make_emulator(rig, rig.device(name), {}) for name in ("ahrs", "gnss")}
    decoders = {"ahrs": vectornav.Decoder(), "gnss": nmea.Decoder()}
    maps = {name: ClockMap() for name in speakers}
    off: dict[str, list[float]] = {name: [] for name in speakers}
    while world.t < 40.0:
        for name, sample, t in world.readings():
            if name in speakers:
                speakers[name].clock_error = faults.clock_error(name, t)
                for frame in decoders[name].feed(speakers[name].encode(sample, t), t):
                    estimate = maps[name].estimate(frame.t_device, frame.t_rx, name == "gnss", type(frame.sample))
                    off[name].append(frame.t_rx - estimate)
        world.advance()
    assert [maps[name].resets for name in speakers] == [1, 1]
    late = {name: sum(late > 0.01 for late in off[name]) for name in speakers}
    assert late["ahrs"] == 0
    assert late["gnss"] <= 5 * ClockMap.AGAIN_FOR + 1  # at 5 Hz: an autopilot's messages may arrive in any order
    assert faults.clock_error("ahrs", 40.0) == pytest.approx(40.0 * 100e-6 - 0.6)


def test_a_motor_draws_current_in_both_directions() -> None:
    for n in (0.8, -0.8):
        sensor = EscSensor(1, 0, 1, 4500.0)
        assert np.mean([sensor.read(n, 20.0 * n, n, 0.0, 0.1).current for _ in range(50)]) > 3.0


def test_garbage_has_the_length_of_the_replaced_bytes() -> None:
    faults = Faults([parse_fault("garbage@1:1")], np.random.default_rng(1))
    whole = b"\xfa" * 40
    assert faults.bytes("ahrs", whole, 0.5) == whole
    assert faults.bytes("ahrs", whole, 1.5) != whole
    assert len(faults.bytes("ahrs", whole, 1.5)) == 40


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("fire@3", "no fault 'fire'; use one of pull"),
        ("pull", "write it as"),
        ("pull/sonar@3", "no device 'sonar'; use one of ahrs, gnss"),
        ("esc-dead/ahrs@3", "no thruster 'ahrs'; use one of left"),
        ("pull@-3", "write it as"),
    ],
)
def test_a_fault_that_makes_no_sense_is_named(text: str, match: str) -> None:
    with pytest.raises(SeatrialError, match=match):
        parse_fault(text, ("ahrs", "gnss"), ("left",))


def test_fault_late_that_starts_again_sends_no_sample_of_the_first_time() -> None:
    faults = Faults([parse_fault("late@1:2"), parse_fault("late@8:2")], RNG)
    t = np.arange(0.0, 11.0, 0.25).tolist()
    sent = {k: faults.reading("gnss", Gnss(k, 41.0, -8.0, fix=3), k) for k in t}
    delay = {k: k - s.utc for k, s in sent.items() if isinstance(s, Gnss)}
    assert max(delay.values()) == 1.0
    assert delay[2.5] == delay[9.5] == 1.0
    assert delay[8.0] == 0.0


def test_fault_mute_on_an_autopilot_leaves_voltage_and_temperature_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = Ends(mav_rig(), role=LinkRole.ASK)
    ends.run(3.0)
    faults, encode = Faults([parse_fault("mute@0:60")], RNG), ends.autopilot.encode

    def muted(sample: Sample, t: float) -> bytes:
        faulty = faults.reading("autopilot", sample, t)
        assert faulty is not None
        return encode(faulty, t)

    before = [frame.sample for frame in ends.frames]
    ends.frames.clear()
    monkeypatch.setattr(ends.autopilot, "encode", muted)
    ends.run(3.0)
    after = [frame.sample for frame in ends.frames]
    assert {(s.voltage, s.temperature) for s in before if isinstance(s, Esc)} == {(15.0, 30.0)}
    assert {(s.voltage, s.temperature, s.current) for s in after if isinstance(s, Esc)} == {(0.0, 0.0, 2.0)}
    assert any(isinstance(s, Battery) for s in before)
    assert not any(isinstance(s, Battery) for s in after)  # its voltage is unknown
