from .environment.waves import FORCES as FORCES
from .environment.waves import WAVES as WAVES
from .nonparametric import NonparametricForce as NonparametricForce
from .nonparametric import harmonics as harmonics
from .nonparametric import input_response_effects as input_response_effects
from .nonparametric import nonparametric_effect as nonparametric_effect
from .nonparametric import shape as shape
from .registry import catalogue as catalogue
