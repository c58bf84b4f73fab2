from .products import PRODUCTS as PRODUCTS
from .products import sensitivity_products as sensitivity_products
from .runner import Sensitivity as Sensitivity
from .runner import chosen as chosen
from .runner import run_sensitivity as run_sensitivity
