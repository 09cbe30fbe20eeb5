from .opening import entry_file as entry_file
from .opening import start_browser as start_browser
from .project_folder import Folder as Folder
from .server import Workbench as Workbench
