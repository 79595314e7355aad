from .formats import export as export
from .formats import file_name as file_name
from .linearisation import Bode as Bode
from .linearisation import LinearModel as LinearModel
from .linearisation import linearise as linearise
from .linearisation import pole_text as pole_text
from .linearisation import side_inputs as side_inputs
from .steady_motion import steady_motion as steady_motion
