from .draft import RigDraft as RigDraft
from .draft import Value as Value
from .draft import drafts_of as drafts_of
from .draft import name_devices as name_devices
from .draft import rig_text as rig_text
