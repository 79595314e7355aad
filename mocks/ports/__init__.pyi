from .network import NetPort as NetPort
from .pty import Port as Port
