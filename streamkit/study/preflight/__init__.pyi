from .preflight import Preflight as Preflight
from .preflight import run_preflight as run_preflight
from .text import describe_preflight as describe_preflight
from .text import describe_spec as describe_spec
from .text import preflight_record as preflight_record
