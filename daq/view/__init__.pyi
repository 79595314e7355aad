from .browser import prepare_browser as prepare_browser
from .live_process import live_page as live_page
from .server import PageServer as PageServer
from .server import listen as listen
from .server import new_token as new_token
from .viewed_log import ViewedLog as ViewedLog
