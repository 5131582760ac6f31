"""palmfield's modules as MuJoCo engine plugins, and the host that runs them."""

from importlib import import_module

# First of all: MuJoCo loads the plugins when it is imported, and they import this package's modules.
import_module("mujoco")
