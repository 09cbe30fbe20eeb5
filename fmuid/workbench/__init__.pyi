from .folder import Folder as Folder
from .server import LOCAL as LOCAL
from .server import Certificate as Certificate
from .server import Workbench as Workbench
