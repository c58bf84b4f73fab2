from .grid import variants_of as variants_of
from .products import PRODUCTS as PRODUCTS
from .products import draw_pictures as draw_pictures
from .products import write_tables as write_tables
from .runner import INTERRUPTED as INTERRUPTED
from .runner import Ablation as Ablation
from .runner import run_ablation as run_ablation
from .tables import describe_ablation as describe_ablation
