from .draw import MASS_RADII as MASS_RADII
from .draw import Draw as Draw
from .draw import rank_truth as rank_truth
from .runner import Calibration as Calibration
from .runner import calibrate as calibrate
from .tables import PRODUCTS as PRODUCTS
from .tables import calibration_products as calibration_products
