from .group import Commands as Commands
from .library import StreamLibrary as StreamLibrary
from .library import Written as Written
from .options import QUIET as QUIET
from .options import RUN_FILE as RUN_FILE
from .options import SET as SET
from .options import directory as directory
from .options import load_spec as load_spec
