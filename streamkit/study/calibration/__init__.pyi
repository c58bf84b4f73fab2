from .draw import MASS_RADII as MASS_RADII
from .draw import Draw as Draw
from .draw import fit_mock as fit_mock
from .draw import measurable_truths as measurable_truths
from .products import PRODUCTS as PRODUCTS
from .products import calibration_products as calibration_products
from .runner import Calibration as Calibration
from .runner import calibrate as calibrate
