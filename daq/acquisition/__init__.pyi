from .session import Acquisition as Acquisition
from .status import NO_STATUS_S as NO_STATUS_S
from .status import PortStatus as PortStatus
from .status import Source as Source
from .status import Status as Status
from .status import StreamedSample as StreamedSample
from .status import count_senders as count_senders
