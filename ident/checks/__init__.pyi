from .log_checks import IMPORTED as IMPORTED
from .log_checks import CheckEvidence as CheckEvidence
from .log_checks import check_copies as check_copies
from .log_checks import check_signals as check_signals
from .log_checks import device_faults as device_faults
from .log_checks import log_evidence as log_evidence
from .log_checks import spoils_a_fit as spoils_a_fit
from .signals import smoothed as smoothed
