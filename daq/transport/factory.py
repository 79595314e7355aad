"""Factory of ports."""

from __future__ import annotations

from seatrial.daq.rig import NET_KINDS, Device, parse_address
from seatrial.daq.transport.base import Port
from seatrial.daq.transport.can_port import SlcanPort, SocketCanPort
from seatrial.daq.transport.network_port import TcpPort, UdpPort
from seatrial.daq.transport.serial_port import SerialPort


def make_port(device: Device) -> Port:
    """Return the port to which a device of the rig is connected: serial, CAN, UDP or TCP. It is not opened.

    The kind follows from the beginning of `device.port`: slcan:, socketcan:, udp:, udpin:, udpout: or tcp:. Any other
    text is the path of a serial port.
    """
    if device.port.startswith("slcan:"):
        return SlcanPort(device.port.removeprefix("slcan:"), device.baud, device.bitrate)
    if device.port.startswith("socketcan:"):
        return SocketCanPort(device.port.removeprefix("socketcan:"))
    if device.port.partition(":")[0] in NET_KINDS:
        return make_net_port(device.port)
    return SerialPort(device.port, device.baud)


def make_net_port(port: str) -> Port:
    """Return the port of an address `udp:HOST:PORT`, `udpin:`, `udpout:` or `tcp:`. It is not opened.

    `udp` and `udpin` listen at the address; `udpout` and `tcp` connect to it.

    Raise ValueError if the address has no host or no valid port number.
    """
    kind = port.partition(":")[0]
    host, number = parse_address(port)
    return TcpPort(host, number) if kind == "tcp" else UdpPort(host, number, listen=kind != "udpout")
