from .discovery import find as find
from .discovery import identify_protocol as identify_protocol
from .export import export_log as export_log
from .info import show as show
from .replay import replay_log as replay_log
