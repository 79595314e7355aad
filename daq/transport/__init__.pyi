from .base import Port as Port
from .base import PortError as PortError
from .base import decode_read as decode_read
from .factory import make_port as make_port
from .ftdi_latency import UDEV_RULE as UDEV_RULE
from .serial_port import SerialPort as SerialPort
from .serial_port import list_serial_ports as list_serial_ports
