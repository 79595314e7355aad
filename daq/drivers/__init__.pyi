from .ardupilot_parameters import check_parameters as check_parameters
from .base import DeviceDriver as DeviceDriver
from .base import LinkRole as LinkRole
from .base import LinkStatus as LinkStatus
from .factory import make_driver as make_driver
from .setpoints import Due as Due
from .setpoints import Setpoints as Setpoints
