"""MuJoCo's model and data as plugins see them: structs, names, poses, states and forces."""

# First of all: on import MuJoCo registers palmfield's plugins, which import this package's modules.
import mujoco as mujoco
