from .products import PRODUCTS as PRODUCTS
from .products import write_products as write_products
from .runner import Sensitivity as Sensitivity
from .runner import chosen as chosen
from .runner import run_sensitivity as run_sensitivity
from .tables import describe_sensitivity as describe_sensitivity
