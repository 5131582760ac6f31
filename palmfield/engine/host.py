"""Python classes as MuJoCo engine plugins.

A module is a subclass of `Module`; `register` makes an mjpPlugin whose callbacks call it. Other packages can add
modules by an entry point of the group `mujoco.plugins` that calls `register`.
"""

import _thread
import ctypes
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco

from palmfield.config import Config, known_keys
from palmfield.errors import PalmfieldError, explained
from palmfield.mujoco_host.mujoco_view import DataView, ModelView
from palmfield.mujoco_host.structs import Plugin, library

if TYPE_CHECKING:
    from palmfield.mujoco_host.drawing import Drawing


class World(DataView):
    """One mjData with the modules of its plugin instances.

    scene: its palmfield scene, made by its first skin; error: error that a module could not raise through C
    view: the picture of the scene, made when it is first drawn; undrawn: whether drawing the scene has failed
    quiet: whether the caller raises the error itself, so that MuJoCo need not print a warning
    """

    def __init__(self, model: int, data: int):
        super().__init__(model, data)
        self.modules: dict[int, Module] = {}
        self.scene: Any = None
        self.view: Any = None
        self.error: Exception | KeyboardInterrupt | None = None
        self.quiet = self.undrawn = False


class Module:
    """One plugin instance of one mjData. A subclass overrides the methods that it needs; the other methods do nothing.

    name: plugin name in the scene, e.g. `palmfield.skin`
    config: keys of the module, a `palmfield.config.Config`; sensor: whether `<sensor><plugin>` may refer to the module
    only_senses: whether this instance only fills sensors, while another instance computes forces and advances the state
    """

    name: ClassVar[str]
    config: ClassVar[type[Config]]
    sensor: ClassVar[bool] = False
    only_senses: bool = False

    def __init__(self, settings: Any, world: World, instance: int):
        self.settings, self.world, self.instance = settings, world, instance

    @classmethod
    def state_size(cls, settings: Any, model: ModelView) -> int:
        """Return the number of plugin state variables that MuJoCo stores in mjData for this instance."""
        return 0

    @classmethod
    def sensor_size(cls, settings: Any, model: ModelView, sensor: int) -> int:
        """Return the dimension of one sensor of this module."""
        return 0

    def forces(self) -> None:
        """Add passive forces at the present time. MuJoCo may call this several times in one step."""

    def sense(self) -> None:
        """Fill the sensors of the module (`self.world.sensors(self.instance)`)."""

    def advance(self) -> None:
        """Advance the state by one step. MuJoCo's time is then already the end of the step."""

    def draw(self, drawing: "Drawing") -> None:
        """Add objects to the next picture of a viewer; this must not change the simulation."""

    def copy_from(self, other: Any) -> None:
        """Copy the data of `other`, the same module in another mjData whose state mj_copyData has copied."""


ADVANCES = -1
"""Capability flag of MuJoCo plugins. MuJoCo calls a plugin with this flag at the end of each step."""
_worlds: dict[int, World] = {}
_lock = threading.RLock()
_thunks: list[Any] = []


class _Compiling(threading.local):
    """State of the model that this thread compiles.

    active: whether modules are switched off; error: error that the constructor of a module raised
    sized: model and instance whose sizes MuJoCo requested last; sizing: model, and the first error of such a request
    """

    active = False
    error: Exception | KeyboardInterrupt | None = None
    sized = (0, -1)
    sizing: tuple[int, Exception | KeyboardInterrupt] | None = None


_compiling = _Compiling()


def world_of(data: mujoco.MjData) -> World | None:
    """Return the World of an MjData, or None if its model has no palmfield plugin."""
    return _worlds.get(data._address)


def raise_errors(data: mujoco.MjData) -> None:
    """Raise, once, a stored error that a module could not raise through the C frames of MuJoCo.

    Raises KeyboardInterrupt if Ctrl-C interrupted a module; the state then lacks a part of the step.
    """
    world = _worlds.get(data._address)
    if world is not None and world.error is not None:
        error, world.error = world.error, None
        raise error


@contextmanager
def compiling() -> Iterator[None]:
    """Switch modules off in the block. MuJoCo tests a compiled model by one step, which would factorise the skins."""
    _compiling.active = True
    try:
        yield
    finally:
        _compiling.active = False


def pop_compile_error() -> Exception | KeyboardInterrupt | None:
    """Return and remove the last error of a module constructor in this thread. MuJoCo's own error has only its text."""
    error, _compiling.error, _compiling.sizing = _compiling.error, None, None
    return error


def _fail(world: World | None, module: str, error: Exception | KeyboardInterrupt) -> None:
    """Store the first error for `raise_errors`, report it through MuJoCo, and set all results to NaN."""
    silent = _compiling.active if world is None else world.quiet or world.error is not None
    if not silent:
        expected = isinstance(error, PalmfieldError | KeyboardInterrupt)
        text = str(error) if expected else "".join(traceback.format_exception(error))
        library().mju_warning(b"%s", f"{module}: {text}".encode())
    if world is not None:
        world.error = world.error or error
        for instance in world.modules:
            for sensor in world.sensors(instance):
                sensor.data[:] = float("nan")


def _cut_off(world: World, module: str) -> None:
    """Store Ctrl-C for `raise_errors`, because an interrupt cannot pass through the C frames of MuJoCo."""
    if world.error is not None:
        # The last error has not been raised. A further Ctrl-C must end a program that never calls `raise_errors`:
        # it is raised again, and ends the program as soon as this thread runs Python
        _thread.start_new_thread(_thread.interrupt_main, ())
    text = "Ctrl-C interrupted a step, so the state is incomplete: reset it, or restore a copy"
    _fail(world, module, KeyboardInterrupt(text))


def register(module: type[Module]) -> None:
    """Register a module with MuJoCo under its name. Registering the same name again has no effect."""
    lib = library()
    if lib.mjp_getPlugin(module.name.encode(), None):
        return

    def size(of: Callable[..., int], otherwise: int, model: int, instance: int, *sensor: int) -> int:
        if _compiling.sizing is not None and _compiling.sizing[0] == model:
            return otherwise  # after an error, or Ctrl-C, nothing is built
        try:
            view = ModelView(model, complete=False)
            return of(view.keys(module.config, instance), view, *sensor)
        except (KeyboardInterrupt, Exception) as error:
            _compiling.sizing = _compiling.sizing or (model, error)
            return otherwise  # init reports it

    def nstate(model: int, instance: int) -> int:
        # MuJoCo requests the instances in order: an earlier instance, or another model, means a new compilation.
        last_model, last_instance = _compiling.sized
        if model != last_model or instance <= last_instance:
            _compiling.sizing = None
        _compiling.sized = model, instance
        return size(module.state_size, 0, model, instance)

    def init(model: int, data: int, instance: int) -> int:
        try:
            sizing, _compiling.sizing = _compiling.sizing, None
            if sizing is not None and sizing[0] == model:
                raise sizing[1]
            with _lock:
                world = _worlds.get(data)
                if world is None or instance in world.modules or world.model.address != model:
                    world = _worlds[data] = World(model, data)
            world.modules[instance] = module(world.model.keys(module.config, instance), world, instance)
            return 0
        except (KeyboardInterrupt, Exception) as error:
            _compiling.error = explained(error) if isinstance(error, Exception) else error
            _fail(None, module.name, _compiling.error)
            return -1

    def copy(data: int, model: int, source: int, instance: int) -> None:
        # The state itself lies in mjData and is copied by MuJoCo; a copy into new memory still lacks the module.
        world = _worlds.get(data)
        if world is None or instance not in world.modules or world.model.address != model:
            init(model, data, instance)
            world = _worlds.get(data)
        origin = _worlds.get(source)
        if world is not None and origin is not None and instance in world.modules and instance in origin.modules:
            world.modules[instance].copy_from(origin.modules[instance])

    # At exit MuJoCo frees its data after the globals of this file; the closure keeps the objects for `destroy`.
    worlds, lock = _worlds, _lock

    def destroy(data: int, instance: int) -> None:
        with lock:
            world = worlds.get(data)
            if world is not None:
                world.modules.pop(instance, None)
                if not world.modules:
                    del worlds[data]

    def reset(model: int, state: int, plugin_data: int, instance: int) -> None:
        count = int(ModelView(model).raw.plugin_statenum[instance])
        if count:
            view = (ctypes.c_double * count).from_address(state)
            ctypes.memset(view, 0, ctypes.sizeof(view))

    sensing = int(mujoco.mjtPluginCapabilityBit.mjPLUGIN_SENSOR)

    def compute(model: int, data: int, instance: int, capability: int = ADVANCES) -> None:
        if _compiling.active:
            return
        world = _worlds[data]
        try:
            target = world.modules[instance]
            if capability == sensing:
                target.sense()
            elif not target.only_senses:
                (target.advance if capability == ADVANCES else target.forces)()
        except KeyboardInterrupt:
            _cut_off(world, module.name)
        except Exception as error:
            _fail(world, module.name, explained(error))

    def visualize(model: int, data: int, options: int, scene: int, instance: int) -> None:
        world = _worlds.get(data)
        if world is None or _compiling.active:
            return
        try:
            from palmfield.mujoco_host.drawing import Drawing  # viewers only

            world.modules[instance].draw(Drawing(world.model, scene, options))
        except KeyboardInterrupt:
            _thread.start_new_thread(_thread.interrupt_main, ())
        except Exception as error:
            # A picture is no result: the run goes on without it, and one warning is enough
            if not world.undrawn:
                lib.mju_warning(b"%s", f"{module.name} cannot be drawn: {explained(error)}".encode())
            world.undrawn = True

    void, integer = ctypes.c_void_p, ctypes.c_int
    flags = 0 if module.forces is Module.forces else int(mujoco.mjtPluginCapabilityBit.mjPLUGIN_PASSIVE)
    if module.sensor:
        flags |= sensing
    keys = [key.encode() for key in known_keys(module.config)]
    attributes = (ctypes.c_char_p * max(len(keys), 1))(*keys)
    plugin = Plugin()
    lib.mjp_defaultPlugin(ctypes.byref(plugin))
    plugin.name = module.name.encode()
    plugin.nattribute, plugin.attributes = len(keys), attributes
    plugin.capabilityflags = flags
    plugin.needstage = int(mujoco.mjtStage.mjSTAGE_ACC)
    prototypes: dict[str, tuple[Callable[..., Any], Any]] = {
        "nstate": (nstate, ctypes.CFUNCTYPE(integer, void, integer)),
        "nsensordata": (partial(size, module.sensor_size, 1), ctypes.CFUNCTYPE(integer, void, integer, integer)),
        "init": (init, ctypes.CFUNCTYPE(integer, void, void, integer)),
        "destroy": (destroy, ctypes.CFUNCTYPE(None, void, integer)),
        "copy": (copy, ctypes.CFUNCTYPE(None, void, void, void, integer)),
        "reset": (reset, ctypes.CFUNCTYPE(None, void, void, void, integer)),
        "compute": (compute, ctypes.CFUNCTYPE(None, void, void, integer, integer)),
        "advance": (compute, ctypes.CFUNCTYPE(None, void, void, integer)),
        "visualize": (visualize, ctypes.CFUNCTYPE(None, void, void, void, void, integer)),
    }
    if module.advance is Module.advance:
        del prototypes["advance"]
    if module.draw is Module.draw:
        del prototypes["visualize"]
    for field, (function, prototype) in prototypes.items():
        thunk = prototype(function)
        # MuJoCo calls destroy after the interpreter has begun to shut down: the thunk must never be freed.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(thunk))
        _thunks.append(thunk)
        setattr(plugin, field, ctypes.cast(thunk, void))
    _thunks.append((plugin, attributes))
    if lib.mjp_registerPlugin(ctypes.byref(plugin)) < 0:
        raise PalmfieldError(f"MuJoCo refused the plugin '{module.name}'")
