from .array_inputs import p0_band as p0_band
from .array_inputs import p0_band_at as p0_band_at
from .numerical_error import error_estimate as error_estimate
from .sensation_levels import felt_levels as felt_levels
from .summary import array_numbers as array_numbers
from .summary import scene_numbers as scene_numbers
from .summary import skin_numbers as skin_numbers
from .summary import stimulus_numbers as stimulus_numbers
