from .network import NetPort as NetPort
from .pty import PtyPort as PtyPort
