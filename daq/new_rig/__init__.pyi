from .draft import RigDraft as RigDraft
from .draft import Value as Value
from .draft import device_of as device_of
from .draft import name_devices as name_devices
from .draft import rig_text as rig_text
