from .evidence import CheckEvidence as CheckEvidence
from .evidence import log_evidence as log_evidence
from .motion import check_sides as check_sides
from .motion import swap_sides as swap_sides
