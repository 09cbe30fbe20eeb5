from .documents import describe as describe
from .figure_files import REPORT_FILE as REPORT_FILE
from .figure_files import clear_figures as clear_figures
from .publish import documents_of as documents_of
from .publish import write_report as write_report
from .run import published as published
from .run import run as run
