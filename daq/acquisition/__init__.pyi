from .session import Acquisition as Acquisition
