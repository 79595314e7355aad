from .evidence import CheckEvidence as CheckEvidence
from .evidence import log_evidence as log_evidence
from .log_checks import check_log as check_log
from .motion import check_sides as check_sides
from .motion import swap_sides as swap_sides
