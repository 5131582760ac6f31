from .build import refusal_lateral_waves as refusal_lateral_waves
from .cost import cost_lateral_waves as cost_lateral_waves
from .solve import solve_lateral_waves as solve_lateral_waves
from .solve import static_lateral_waves as static_lateral_waves
