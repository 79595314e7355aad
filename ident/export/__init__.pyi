from .formats import export as export
from .linearisation import Linearisation as Linearisation
from .linearisation import linearise as linearise
from .steady_motion import steady_motion as steady_motion
