from .design import Design as Design
from .design import Range as Range
from .design import grid as grid
from .design import listed as listed
from .design import random as random
from .design import sobol as sobol
from .whole_sweep import Sweep as Sweep
from .whole_sweep import sweep as sweep
