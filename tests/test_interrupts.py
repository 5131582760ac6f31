import os
import signal
import threading
import time

import numpy as np
import pytest

from palmfield.interrupts import interrupts_delayed, left_by_interrupts


@pytest.fixture(autouse=True)
def python_raises():
    """A shell that runs tests in the background has them ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_waits_until_it_is_asked_for():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts_delayed() as check:
        signal.raise_signal(signal.SIGINT)
        done.append("the step")
        check()
        done.append("no more")
    assert done == ["the step"]


def test_ctrl_c_is_not_lost_at_the_end():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interrupts_delayed():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_an_error_comes_first():
    with pytest.raises(ValueError, match="first"), interrupts_delayed():
        signal.raise_signal(signal.SIGINT)
        raise ValueError("first")


def test_another_thread_goes_on():
    def work():
        with interrupts_delayed() as check:
            check()
            done.append(True)

    done = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]


def test_inside_another_block_the_outer_one_raises():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts_delayed() as check:
        with interrupts_delayed() as inner:
            signal.raise_signal(signal.SIGINT)
            inner()
            done.append("inner")
        done.append("outer")
        check()
        done.append("no more")
    assert done == ["inner", "outer"]
    with pytest.raises(KeyboardInterrupt), interrupts_delayed() as check:  # and the next block holds again
        signal.raise_signal(signal.SIGINT)
        done.append("next")
    assert done[-1] == "next"


def test_a_handler_of_the_program_is_called_when_asked_for():
    seen = []
    signal.signal(signal.SIGINT, lambda number, frame: seen.append(number))
    with interrupts_delayed() as check:
        signal.raise_signal(signal.SIGINT)
        assert seen == []
        check()
        assert seen == [signal.SIGINT]
        check()
    assert seen == [signal.SIGINT]


def test_a_process_that_ignores_ctrl_c_still_does():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interrupts_delayed() as check:
        signal.raise_signal(signal.SIGINT)
        check()
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_a_long_native_call_is_left_at_once():
    matrix = np.random.default_rng(0).standard_normal((1500, 1500))
    ended = []

    def work():
        found = np.linalg.eigvalsh(matrix @ matrix.T)
        ended.append(time.perf_counter())
        return found

    plain = left_by_interrupts(work)
    np.testing.assert_array_equal(plain, np.linalg.eigvalsh(matrix @ matrix.T))
    ended.clear()
    threading.Timer(0.02, os.kill, [os.getpid(), signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        left_by_interrupts(work)
    assert not ended
    while not ended:
        time.sleep(0.01)


def test_its_errors_are_raised_and_other_threads_do_it_themselves():
    with pytest.raises(ZeroDivisionError):
        left_by_interrupts(lambda: 1 / 0)
    names = []
    thread = threading.Thread(target=lambda: left_by_interrupts(lambda: names.append(threading.current_thread())))
    thread.start()
    thread.join()
    assert names == [thread]
