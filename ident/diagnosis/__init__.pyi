from .adequacy import recommended_experiment as recommended_experiment
from .results import Diagnosis as Diagnosis
from .results import Refit as Refit
from .results import Round as Round
from .results import ValidationMismatch as ValidationMismatch
from .search import DiagnosisEvaluation as DiagnosisEvaluation
from .search import diagnose as diagnose
from .search import evaluate_diagnosis as evaluate_diagnosis
