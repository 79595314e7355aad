from .cases import make_case as make_case
from .monte_carlo import Case as Case
from .monte_carlo import ParameterCoverage as ParameterCoverage
from .monte_carlo import Row as Row
from .monte_carlo import counts as counts
from .monte_carlo import estimator_code_hash as estimator_code_hash
from .monte_carlo import run_replicates as run_replicates
from .monte_carlo import summarise as summarise
