from .axisymmetric.solve import solve_axisymmetric as solve_axisymmetric
from .lateral_waves.solve import solve_lateral_waves as solve_lateral_waves
from .lateral_waves.solve import static_lateral_waves as static_lateral_waves
from .particles.solve import solve_particles as solve_particles
from .reduced import solve_reduced as solve_reduced
from .spectral_elements.solve import solve_spectral_elements as solve_spectral_elements
from .wedges import solve_wedges as solve_wedges
from .wedges import static_wedges as static_wedges
