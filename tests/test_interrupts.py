import signal
import threading

import pytest

from palmfield.interrupts import interrupts_delayed


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
