from . import bench as bench
from . import catalogue as catalogue
from . import realistic as realistic
