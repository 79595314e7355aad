"""UDP and TCP ports over real loopback sockets."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.daq.acquisition.device_loop import DeviceLoop
from seatrial.daq.acquisition.log_thread import LogSink
from seatrial.daq.acquisition.watchdog import FailsafeSender
from seatrial.daq.clock import RunClock
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.drivers.base import LinkRole
from seatrial.daq.drivers.factory import make_driver
from seatrial.daq.drivers.setpoints import Setpoints
from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol.catalogue import make_decoder
from seatrial.daq.protocol.mavlink import MavlinkDecoder
from seatrial.daq.protocol.mavlink_wire import Codec, FrameHeader, parse_header
from seatrial.daq.transport.base import Port, PortError, decode_read
from seatrial.daq.transport.factory import make_net_port, make_port
from seatrial.daq.transport.network_port import SILENT_S, UdpPort
from tests.daq.mavlink_ends import rig_text
from tests.daq.ptys import wait_for


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(2.0)
        yield sock


def free(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def read(port: Port) -> bytes:
    assert select.select([port.fileno()], [], [], 2.0)[0]
    return port.read()


def test_only_a_confirmed_sender_is_answered_and_keeps_the_link(
    peer: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    number = free()
    port = make_net_port(f"udp:127.0.0.1:{number}")
    port.open()
    port.write(b"nobody is there")  # lost, and no error
    peer.sendto(b"one", ("127.0.0.1", number))
    peer.sendto(b"two", ("127.0.0.1", number))
    assert read(port) == b"one"
    assert not port.is_confirmed
    port.write(b"nobody is known")
    assert read(port) == b"two"
    port.confirm()
    assert port.is_confirmed
    port.write(b"answer")
    assert peer.recv(100) == b"answer"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"mine", ("127.0.0.1", number))
        assert b"mine" not in read(port)
        assert port.unparsed_bytes == 4
        assert isinstance(port, UdpPort)
        port._heard_at -= SILENT_S  # as if the first had been silent for so long
        stranger.sendto(b"mine", ("127.0.0.1", number))
        assert read(port) == b"mine"
        assert not port.is_confirmed
        port.confirm()
        stranger.settimeout(2.0)
        port.write(b"yours")
        assert stranger.recv(100) == b"yours"
    port.close()
    assert port.fileno() == -1


def test_a_listening_port_is_taken_over_from_a_process_that_still_has_it(peer: socket.socket) -> None:
    number = free()
    hung, second, watchdog = (make_net_port(f"udp:127.0.0.1:{number}") for _ in range(3))
    hung.open()
    with pytest.raises(PortError, match="in use by another program"):
        second.open()
    peer.sendto(b"before", ("127.0.0.1", number))
    assert read(hung) == b"before"
    watchdog.take_over()
    for k in range(5):
        peer.sendto(b"%d" % k, ("127.0.0.1", number))
        assert read(watchdog) == b"%d" % k
    watchdog.confirm()
    watchdog.write(b"zero")
    assert peer.recvfrom(10) == (b"zero", ("127.0.0.1", number))
    with pytest.raises(PortError, match="in use by another program"):
        second.open()
    watchdog.close()
    hung.close()
    second.open()  # nothing is left of it
    second.close()


def test_udpout_sends_before_the_receiver_listens(peer: socket.socket) -> None:
    number = free()
    port = make_net_port(f"udpout:127.0.0.1:{number}")
    port.open()
    port.write(b"a")
    port.write(b"b")  # the system says "refused" here: nobody listens yet, which is no loss of the port
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", number))
        there.settimeout(2.0)
        port.write(b"c")
        data, sender = there.recvfrom(100)
        assert data == b"c"
        there.sendto(b"d", sender)
        assert read(port) == b"d"
    port.close()


def test_tcp_connects_and_a_closed_connection_is_a_lost_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = make_net_port(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        port.open()
        peer, _ = server.accept()
        with peer:
            port.write(b"hello")
            assert peer.recv(100) == b"hello"
            peer.sendall(b"world")
            assert read(port) == b"world"
        with pytest.raises(PortError, match="closed the connection"):
            read(port)
        port.close()


def test_a_port_that_cannot_be_opened_gives_an_error_with_the_reason(peer: socket.socket) -> None:
    with pytest.raises(PortError, match="no program listens there"):
        make_net_port(f"tcp:127.0.0.1:{free(socket.SOCK_STREAM)}").open()
    with pytest.raises(PortError, match="in use by another program"):
        make_net_port(f"udpin:127.0.0.1:{peer.getsockname()[1]}").open()
    with pytest.raises(PortError, match="no address"):
        make_net_port("udpout:no.such.host.invalid:14550").open()


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("udp:127.0.0.1:14550", "udp:14550"), r"device\[1\].port: must be udp:HOST:PORT"),
        (("udp:127.0.0.1:14550", "tcp:host:x"), r"device\[1\].port: must be udp:HOST:PORT"),
        (("rc_channel = 1", "rc_channel = 19"), r"rc_channel: must be within 1 .. 18"),
        (
            ("rc_channel = 3", "rc_channel = 1"),
            r"thruster: 'autopilot rc_channel 1' appears twice; give each thruster its own",
        ),
        (("node = 1", "node = 17"), r"thruster\[1\].node: must be the number of a servo output, 1 .. 16, not 17"),
        (("rpm_max = 4500.0", "pwm_us = [1500, 1500, 1900]"), r"pwm_us: must be \[full reverse, neutral"),
        (
            ("rate_hz = 25.0", "rate_hz = 25.0\nown_system_id = 1"),
            "own_system_id: 1 is the system_id of the autopilot",
        ),
        (("rate_hz = 25.0", 'rate_hz = 25.0\ngnss = "best"'), r"gnss: must be one of raw, fused, not 'best'"),
        (("[[thruster]]", "[device.rates]\nATTITUD = 5.0\n[[thruster]]"), r"rates.ATTITUD: not a supported message"),
    ],
)
def test_error_names_the_invalid_key_of_a_rig(change: tuple[str, str], line: str) -> None:
    text = rig_text().replace(*change, 1)
    with pytest.raises(SeatrialError, match=line) as caught:
        parse_rig(text, Path("rig.toml"))
    assert "\n" not in str(caught.value)


def test_rates_are_requested_in_order_and_can_be_set() -> None:
    rig = parse_rig(rig_text(more='gnss = "fused"\nrates = {RAW_IMU = 0.0, ATTITUDE = 10.0}'), Path("rig.toml"))
    device = rig.device("autopilot")
    assert device.mavlink is not None
    rates = device.mavlink.requested(device.rate_hz)
    assert list(rates)[:2] == ["ATTITUDE", "SERVO_OUTPUT_RAW"]
    assert (rates["ATTITUDE"], rates["SERVO_OUTPUT_RAW"], rates["GLOBAL_POSITION_INT"]) == (10.0, 25.0, 5.0)
    assert not {"RAW_IMU", "GPS_RAW_INT"} & set(rates)


KEY = bytes(range(32))


def rover(key: bytes | None = None, system: int = 1) -> Codec:
    return Codec(system, 1, key, 1_800_000_000.0)


def heartbeat(codec: Codec) -> bytes:
    return codec.encode("HEARTBEAT", 11, 3, 81, 0, 4, 3)


@pytest.mark.parametrize("signed", [False, True])
def test_the_peer_is_the_first_sender_of_a_frame_of_the_autopilot(tmp_path: Path, signed: bool) -> None:
    """Neither a stray byte, half a frame, another system, nor (where there is a key) an unsigned frame locks it out."""
    number = free()
    (tmp_path / "key").write_bytes(KEY)
    more = 'key_file = "key"' if signed else ""
    rig = parse_rig(rig_text(f"udp:127.0.0.1:{number}", more=more), tmp_path / "rig.toml")
    device = rig.devices[0]
    decoder, port = make_decoder(device, rig), make_port(device)
    driver = make_driver(device, rig, decoder, LinkRole.DRIVE)
    loop = DeviceLoop(device, port, decoder, RunClock(), LogSink(), Setpoints(), driver)
    autopilot = rover(KEY if signed else None)
    loop.start()
    here = ("127.0.0.1", number)
    strange = [b"\xfd", heartbeat(rover(KEY if signed else None, system=7)), heartbeat(rover())[:-3]]
    strange += [heartbeat(rover())] if signed else []
    with contextlib.ExitStack() as stack:
        strangers = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in strange]
        own = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        for sock in (own, *strangers):
            sock.settimeout(5.0)
        wait_for(lambda: port.fileno() >= 0)
        for sock, data in zip(strangers, strange, strict=True):
            sock.sendto(data, here)
        wait_for(lambda: port.bytes_in == sum(map(len, strange)))
        own.sendto(heartbeat(autopilot), here)
        assert own.recv(1000)  # its ground station answers
        for sock in strangers:
            sock.setblocking(False)
            with pytest.raises(BlockingIOError):
                sock.recv(1000)
        # After silence another address of the same autopilot is learnt again, and by a frame alone.
        assert isinstance(port, UdpPort)
        port._heard_at -= SILENT_S
        strangers[0].sendto(b"\xfd", here)
        new = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        new.settimeout(5.0)
        new.sendto(heartbeat(autopilot), here)
        assert new.recv(1000)
        with pytest.raises(BlockingIOError):
            strangers[0].recv(1000)
    loop.end()
    loop.join()


def test_a_frame_is_not_put_together_of_two_senders(tmp_path: Path) -> None:
    """Else a stranger's head would make the autopilot's own frame confirm the stranger."""
    number = free()
    rig = parse_rig(rig_text(f"udp:127.0.0.1:{number}"), tmp_path / "rig.toml")
    device = rig.devices[0]
    decoder, port = make_decoder(device, rig), make_port(device)
    port.open()
    frame = heartbeat(rover())
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first_sender,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second_sender,
    ):
        for sock, data in ((first_sender, frame[:10]), (second_sender, frame[10:])):
            sock.sendto(data, ("127.0.0.1", number))
            decode_read(port, decoder, read(port), 0.0)
            assert not port.is_confirmed
    assert isinstance(decoder, MavlinkDecoder)
    assert decoder.accepted == 0
    port.close()


def test_an_old_watchdog_is_still_accepted_on_a_signed_link(tmp_path: Path) -> None:
    """Oracle: pymavlink's own check of an autopilot that has since heard, and sent, later signatures."""
    number = free()
    (tmp_path / "key").write_bytes(KEY)
    rig = parse_rig(rig_text(f"udp:127.0.0.1:{number}", more='key_file = "key"'), tmp_path / "rig.toml")
    now = time.time()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "time", lambda: now - 300.0)
        sender = FailsafeSender(rig.devices[0], rig)
    autopilot, runner = Codec(1, 1, KEY, now), Codec(255, 190, KEY, now)
    assert autopilot.decode(heartbeat(runner)) is not None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.settimeout(0.02)
        sender.start()
        heard: list[str] = []
        while sender.is_alive():
            own.sendto(heartbeat(autopilot), ("127.0.0.1", number))
            with contextlib.suppress(TimeoutError):
                data = own.recv(1000)
                while data:
                    about = parse_header(data, 0)
                    assert isinstance(about, FrameHeader)
                    message = autopilot.decode(data[: about.total])
                    heard += [] if message is None else [message.get_type()]
                    data = data[about.total :]
        sender.join()
    assert sender.outcome == "zero thrust was sent, and not answered: it may still be armed"  # nobody here answers
    assert heard.count("RC_CHANNELS_OVERRIDE") > 5
    assert heard.count("COMMAND_LONG") > 5
