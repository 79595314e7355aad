from .device_startup import silent_devices as silent_devices
from .link_test import ALLOWED_S as ALLOWED_S
from .link_test import link_test_plan as link_test_plan
from .operator_interface import PlainDisplay as PlainDisplay
from .operator_interface import make_display as make_display
from .runner import run_link_test as run_link_test
from .runner import run_mission as run_mission
from .safety_guard import SafetyGuard as SafetyGuard
