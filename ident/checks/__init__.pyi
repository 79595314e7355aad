from .evidence import envelope as envelope
from .evidence import log_evidence as log_evidence
from .log_checks import as_dicts as as_dicts
from .motion import check_sides as check_sides
from .motion import swap_sides as swap_sides
