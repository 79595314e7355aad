from .check_page import write_check_page as write_check_page
from .design_page import write_design_page as write_design_page
from .formatting import typeset_unit as typeset_unit
from .page import write_report as write_report
from .study_page import study_as_text as study_as_text
from .study_page import write_study_docs as write_study_docs
from .study_page import write_study_page as write_study_page
from .terminal import print_result as print_result
