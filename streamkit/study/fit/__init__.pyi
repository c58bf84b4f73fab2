from .directory import RECOVERY as RECOVERY
from .export import EXPORTS as EXPORTS
from .export import write_samples as write_samples
from .products import write_products as write_products
from .recovery import describe_recovery as describe_recovery
from .results import Results as Results
from .runner import run as run
from .text import describe_results as describe_results
