from .solve import cost_axisymmetric as cost_axisymmetric
from .solve import refusal_axisymmetric as refusal_axisymmetric
from .solve import solve_axisymmetric as solve_axisymmetric
