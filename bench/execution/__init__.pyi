from .device_startup import silent_devices as silent_devices
from .operator_interface import PlainDisplay as PlainDisplay
from .operator_interface import make_display as make_display
from .runner import run_mission as run_mission
from .safety_guard import SafetyGuard as SafetyGuard
