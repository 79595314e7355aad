from .autopilot_messages import LOOP_HZ as LOOP_HZ
from .base import DeviceEmulator as DeviceEmulator
from .emulators import by_side as by_side
from .emulators import make_emulator as make_emulator
from .faults import KINDS as KINDS
from .faults import Faults as Faults
from .faults import parse_fault as parse_fault
