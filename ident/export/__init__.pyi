from .codegen import prefix as prefix
from .formats import export as export
from .formats import file_name as file_name
from .linearisation import Linearisation as Linearisation
from .linearisation import linearise as linearise
from .steady_motion import steady_motion as steady_motion
