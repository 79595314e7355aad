from .adequacy import recommended_experiment as recommended_experiment
from .results import Diagnosis as Diagnosis
from .results import Refit as Refit
from .results import Round as Round
from .score_test import ALPHA as ALPHA
from .score_test import Score as Score
from .search import diagnose as diagnose
