from .check_page import write_check_page as write_check_page
from .design_page import write_design_page as write_design_page
from .formatting import tidy as tidy
from .page import write_report as write_report
from .study_page import as_text as as_text
from .study_page import write_study_docs as write_study_docs
from .study_page import write_study_page as write_study_page
from .terminal import print_result as print_result
