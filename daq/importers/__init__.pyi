from .csv_import import import_csv as import_csv
from .mavlink import import_mavlink as import_mavlink
from .raw import import_raw as import_raw
from .ros2 import import_ros2 as import_ros2
from .ulog import import_ulog as import_ulog
