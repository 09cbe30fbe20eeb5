from .document import Document as Document
from .publish import documents_of as documents_of
from .publish import write_report as write_report
from .run import published as published
from .run import run as run
