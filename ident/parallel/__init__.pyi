from .result_table import ResultTable as ResultTable
from .result_table import write_rows as write_rows
from .tasks import TaskOutcome as TaskOutcome
from .tasks import run_many as run_many
from .workers import Workers as Workers
