from .formats import export as export
from .linearisation import Linearisation as Linearisation
from .linearisation import linearise as linearise
