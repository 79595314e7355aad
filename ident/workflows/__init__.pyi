from . import information as information
from . import noise as noise
from .check import write_check as write_check
from .design import DesignRequest as DesignRequest
from .design import make_design as make_design
from .design import summary as summary
