from .navigator import CURRENT as CURRENT
from .navigator import POSITION as POSITION
from .navigator import Navigation as Navigation
from .navigator import navigate as navigate
from .outages import Outage as Outage
from .outages import OutageErrors as OutageErrors
from .outages import gnss_outages as gnss_outages
