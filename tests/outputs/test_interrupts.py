import signal
import threading

import pytest

from palmfield.outputs.interrupts import interrupts_held


def test_ctrl_c_waits_until_it_is_asked_for():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts_held() as check:
        signal.raise_signal(signal.SIGINT)
        done.append("the step")
        check()
        done.append("no more")
    assert done == ["the step"]


def test_ctrl_c_is_not_lost_at_the_end():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interrupts_held():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_an_error_comes_first():
    with pytest.raises(ValueError, match="first"), interrupts_held():
        signal.raise_signal(signal.SIGINT)
        raise ValueError("first")


def test_another_thread_goes_on():
    def work():
        with interrupts_held() as check:
            check()
            done.append(True)

    done = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]
