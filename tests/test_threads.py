"""Work shared out among threads."""

import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from palmfield import threads
from palmfield.threads import share

pytestmark = pytest.mark.usefixtures("all_cores")


def test_the_first_error_of_a_helper_is_raised_when_none_works_any_more():
    """The caller's own block lasts until two helpers have begun theirs; one of them fails, and the other goes on."""
    caller, begun, failing, finished = threading.current_thread(), threading.Barrier(3), threading.Lock(), []

    def block():
        begun.wait(10.0)
        if threading.current_thread() is caller:
            time.sleep(0.05)
        elif failing.acquire(blocking=False):
            raise ValueError("a helper's own words")
        else:
            time.sleep(0.3)
            finished.append(True)

    for _ in range(3):
        failing, finished[:] = threading.Lock(), []
        with pytest.raises(ValueError, match="own words"):
            share([[block]] * 3, 3)
        assert finished == [True]


def test_the_callers_own_error_waits_for_the_helpers():
    caller, begun, finished = threading.current_thread(), threading.Barrier(2), []

    def block():
        begun.wait(10.0)
        if threading.current_thread() is caller:
            raise ValueError("the caller's own words")
        time.sleep(0.2)
        finished.append(True)

    with pytest.raises(ValueError, match="the caller's own words"):
        share([[block]] * 2, 2)
    assert finished == [True]


def test_ctrl_c_waits_for_the_helpers():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    caller, begun, finished = threading.current_thread(), threading.Barrier(2), []

    def block():
        begun.wait(10.0)
        if threading.current_thread() is not caller:
            time.sleep(0.1)
            signal.pthread_kill(caller.ident, signal.SIGINT)
            time.sleep(0.2)
            finished.append(True)

    try:
        with pytest.raises(KeyboardInterrupt):
            share([[block]] * 2, 2)
    finally:
        signal.signal(signal.SIGINT, before)
    assert finished == [True]


def test_a_limit_of_cores_holds_until_it_is_lifted():
    everything = threads.cores()
    try:
        threads.limit(1)
        assert threads.cores() == 1
        threads.limit(10 * everything)
        assert threads.cores() == everything
        with pytest.raises(ValueError, match="the limit is 0 cores; allowed: at least 1"):
            threads.limit(0)
    finally:
        threads.limit(None)
    assert threads.cores() == everything


def test_threads_may_be_the_first_to_launch_a_kernel():
    """Each loads the kernel's module; a thread that was left with code which another had unloaded would crash."""
    body = textwrap.dedent(
        """
        import sys, threading
        import warp as wp
        from palmfield import device
        from palmfield.device import recorded
        from warp_kernels.modes import Modes, lanes, step_modes
        sys.setswitchinterval(1e-6)
        model = Modes()
        model.advance = wp.zeros((1, 2, 2), dtype=lanes, device="cpu")
        model.inputs = wp.zeros((1, 2), dtype=lanes, device="cpu")
        ready = threading.Barrier(8)
        def work():
            shapes = (1, 1, 1), (1, 2, 1), (1, 2, 1), (1, 1, 2, 1)
            room = [wp.zeros(shape, dtype=lanes, device="cpu") for shape in shapes]
            ready.wait()
            call = recorded(step_modes, (1, 1), [model, *room], "cpu")
            for _ in range(100):
                call()
        for _ in range(20):
            step_modes.module.unload()
            device._loads.clear()
            threads = [threading.Thread(target=work) for _ in range(8)]
            for thread in threads: thread.start()
            for thread in threads: thread.join()
        """
    )
    done = subprocess.run([sys.executable, "-c", body], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
