from .measure import Data as Data
from .measure import measure_stream as measure_stream
from .track import CELL as CELL
from .track import ENOUGH as ENOUGH
from .track import Track as Track
from .track import mean_track as mean_track
from .track import quantiles as quantiles
