from .project_folder import Folder as Folder
from .server import Workbench as Workbench
from .server import entry_file as entry_file
from .server import start_browser as start_browser
