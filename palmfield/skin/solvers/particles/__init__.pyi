from .resolution import cost_particles as cost_particles
from .resolution import refusal_particles as refusal_particles
from .solve import solve_particles as solve_particles
