from .jobs import DIED as DIED
from .jobs import INTERRUPTED as INTERRUPTED
from .jobs import run_jobs as run_jobs
from .products import Products as Products
from .products import draw_pictures as draw_pictures
from .products import write_tables as write_tables
