from .session import Acquisition as Acquisition
from .status import PortStatus as PortStatus
from .status import Source as Source
from .status import Status as Status
from .status import StreamedSample as StreamedSample
