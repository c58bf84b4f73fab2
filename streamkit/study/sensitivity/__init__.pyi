from .runner import Sensitivity as Sensitivity
from .runner import chosen as chosen
from .runner import run_sensitivity as run_sensitivity
from .tables import PRODUCTS as PRODUCTS
from .tables import sensitivity_products as sensitivity_products
