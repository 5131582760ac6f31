"""What is sent next, on a clock of the test's own: a port that takes all at once, and a line of 1 ms a byte."""

from itertools import pairwise

import pytest

from palmfield.drive.player.budget import SoundBudget
from palmfield.drive.player.line_clock import LineClock
from palmfield.drive.player.messages import Job, LiveFrame, Schedule
from palmfield.drive.player.sources import LiveSource, ScheduleSource, on_the_line

BYTE_S = 1e-3
FRAME_S = 10 * BYTE_S
STOP = b"s" * 10


def frame(number: int) -> bytes:
    return number.to_bytes(10, "big")


def play(source, *, until_s: float = 100.0, busy=(), begin_s: float = 0.0, on_time=None):
    """(when handed over, when on the line, due, bytes) of all that is sent; busy: while nobody plays."""
    line, now, sent = LineClock(BYTE_S), begin_s, []
    while now < until_s:
        for start, end in busy:
            if start <= now < end:
                now = end
        if on_time is not None:
            on_time(now)
        choice = source.choose(now, line.free_s(now))
        if choice is None:
            return sent
        if choice.at_s > now:
            now = min(choice.at_s, now + 5e-3)
            continue
        if choice.data:
            ends = line.hand(len(choice.data), now)
            sent.append((now, ends, choice.due_s, choice.data))
            source.sent(now)
    return sent


def scheduled(times, duration_s=0.0):
    return ScheduleSource(Schedule(times, [frame(n) for n in range(len(times))], duration_s), BYTE_S, 0.0)


def test_frames_are_on_the_line_at_their_times():
    times = [0.0, 0.02, 0.05, 0.06]
    sent = play(scheduled(times))
    assert [data for *_, data in sent] == [frame(n) for n in range(4)]
    assert [ends for _, ends, _, _ in sent] == pytest.approx([t + FRAME_S for t in times])
    assert [ends for _, ends, _, _ in sent] == pytest.approx([due for _, _, due, _ in sent])


def test_at_the_lines_rate_one_frame_waits_and_the_line_has_no_pause():
    source = scheduled([n * FRAME_S for n in range(100)])
    sent = play(source)
    assert source.skipped == 0 and len(sent) == 100
    assert max(ends - due for _, ends, due, _ in sent) < 1e-9
    # Handed over one frame's time before its first byte is on the line, never more
    assert max(ends - FRAME_S - at for at, ends, _, _ in sent) == pytest.approx(FRAME_S)
    # So that a pause of almost that costs nothing
    late = play(scheduled([n * FRAME_S for n in range(100)]), busy=[(0.301, 0.309)])
    assert len(late) == 100 and max(ends - due for _, ends, due, _ in late) < 1e-9


def test_after_a_long_pause_the_newest_frame_comes_and_is_on_time():
    source = scheduled([n * 0.0125 for n in range(200)])
    sent = play(source, busy=[(0.5, 1.5)])
    assert source.skipped == 200 - len(sent) == pytest.approx(80, abs=2)
    after = [(ends - due) for at, ends, due, _ in sent if at >= 1.5]
    assert after[0] < 0.0125 and max(after[1:]) < 1e-9


def test_faster_than_the_line_is_thinned_and_never_older():
    source = scheduled([n * 1e-3 for n in range(1000)])
    sent = play(source)
    numbers = [int.from_bytes(data, "big") for *_, data in sent]
    assert all(b > a for a, b in pairwise(numbers)) and len(sent) + source.skipped == 1000
    assert len(sent) == pytest.approx(100, abs=2)
    assert max(ends - due for _, ends, due, _ in sent) <= FRAME_S


def test_the_last_frame_lasts_and_nothing_is_over_at_once():
    ends = []
    source = scheduled([0.0], 0.5)
    play(source, on_time=ends.append)
    assert ends[-1] == pytest.approx(0.5 + FRAME_S, abs=6e-3)
    assert play(scheduled([])) == []


def test_a_schedule_that_was_paused_goes_on_from_there_and_sounds_at_once():
    source = scheduled([n * 0.1 for n in range(10)])

    def pause(now: float) -> None:
        if now > 0.35 and not paused:
            paused.append(now)
            source.shift(1.0)

    paused: list[float] = []
    sent = play(source, on_time=pause)
    assert source.skipped == 0
    numbers = [int.from_bytes(data, "big") for *_, data in sent]
    assert numbers == [0, 1, 2, 3, 3, 4, 5, 6, 7, 8, 9]
    assert sent[5][1] - sent[4][1] <= 1.1 and sent[6][1] - sent[5][1] == pytest.approx(0.1)


# -- live --------------------------------------------------------------------------------------------------------------


def live(ramp_s=0.0, budget=None) -> LiveSource:
    return LiveSource(BYTE_S, STOP, ramp_s=ramp_s, stale_s=0.1, refresh_s=0.1, budget=budget or SoundBudget())


def fed(source: LiveSource, period_s: float, from_s: float, to_s: float, steps: int = 1):
    """Calls that give a source a frame each period, whose bytes tell the period's number and the step."""
    state = [0]

    def feed(now: float) -> None:
        number = int((now - from_s) / period_s)
        while from_s <= now < to_s and state[0] <= number:
            made = from_s + state[0] * period_s
            levels = [bytes([state[0] % 256, step]) + 8 * b"x" for step in range(1, steps + 1)]
            source.accept(LiveFrame(made, 1.0, levels))
            state[0] += 1

    return feed


def test_live_frames_go_at_once_and_only_the_newest_waits():
    source = live()
    sent = play(source, until_s=1.0, on_time=fed(source, 4e-3, 0.0, 1.0))
    # A frame takes 10 ms and a new one comes each 4 ms: it waits for the line, and the older ones are left out
    assert max(ends - due for _, ends, due, _ in sent) <= 4e-3 + 5e-3 + 1e-3
    assert len(sent) == pytest.approx(100, abs=3) and source.skipped == pytest.approx(150, abs=5)


def test_what_is_old_falls_silent_and_sounds_again_with_a_new_frame():
    source = live()
    feeds = [fed(source, 0.02, 0.0, 0.3), fed(source, 0.02, 0.8, 1.0)]
    sent = play(source, until_s=1.3, on_time=lambda now: [feed(now) for feed in feeds])
    stops = [at for at, _, _, data in sent if data == STOP]
    assert stops == [pytest.approx(0.28 + 0.1, abs=0.012), pytest.approx(0.98 + 0.1, abs=0.012)]
    between = [at for at, *_ in sent if stops[0] < at < 0.79]
    assert between == []
    assert source.reason == "no frame arrived for 0.1 s"


def test_sound_rises_and_falls_within_the_ramp():
    source = live(ramp_s=0.1)
    sent = play(source, until_s=0.8, on_time=fed(source, 0.01, 0.0, 0.4, steps=5))
    steps = [(at, data[1]) for at, _, _, data in sent if data != STOP]
    rise = [step for at, step in steps if at < 0.15]
    assert rise[0] == 1 and rise[-1] == 5 and all(b >= a for a, b in pairwise(rise))
    full = next(at for at, step in steps if step == 5)
    assert full - steps[0][0] == pytest.approx(0.08, abs=0.02)
    fall = [step for at, step in steps if at > 0.45]
    assert fall[0] == 5 and all(b <= a for a, b in pairwise(fall)) and set(fall) >= {4, 3, 2, 1}
    assert sent[-1][3] == STOP
    assert sent[-1][0] == pytest.approx(0.39 + 0.1 + 0.1, abs=0.03)


def test_what_fades_falls_within_the_ramp_and_shows_nothing_newer():
    source = live(ramp_s=0.1)
    feed = fed(source, 0.01, 0.0, 1.0, steps=5)

    def until_fade(now: float) -> None:
        if now < 0.5:
            feed(now)
        elif not source.muted:
            source.accept(LiveFrame(now, 1.0, [frame(9)], due_s=0.7))
            source.fade()

    sent = play(source, until_s=0.8, on_time=until_fade)
    fall = [data[1] for at, _, _, data in sent if at > 0.5 and data != STOP]
    assert all(b <= a for a, b in pairwise(fall)) and set(fall) >= {3, 2, 1}
    assert sent[-1][3] == STOP and sent[-1][0] == pytest.approx(0.6, abs=0.03) and source.silent


def test_frames_that_are_due_wait_for_their_time_and_the_newest_that_is_due_wins():
    """Ten are given at once, each 20 ms after the one before; nobody plays from 0.105 to 0.165 s."""
    source = live()
    for number in range(10):
        source.accept(LiveFrame(0.0, 1.0, [frame(number)], due_s=0.03 + 0.02 * number))
    sent = play(source, until_s=0.4, busy=[(0.105, 0.165)])
    shown = [(int.from_bytes(data, "big"), ends, due) for _, ends, due, data in sent if data != STOP]
    numbers = [number for number, *_ in shown]
    # The last one is sent again after 0.1 s, as it rests
    assert numbers == [0, 1, 2, 3, 4, 7, 8, 9, 9] and source.skipped == 2
    late = [ends - due for number, ends, due in shown[:8] if number != 7]
    assert late == pytest.approx([0.0] * 7, abs=1e-9)
    # Old by then, as nothing newer was given
    assert sent[-1][3] == STOP and sent[-1][0] == pytest.approx(0.21 + 0.1, abs=0.012)


def test_a_frame_without_a_time_takes_the_place_of_all_that_wait():
    source = live()
    for number in range(3):
        source.accept(LiveFrame(0.0, 1.0, [frame(number)], due_s=0.05 + 0.02 * number))

    def interrupt(now: float) -> None:
        if now >= 0.06 and not done:
            done.append(now)
            source.accept(LiveFrame(now, 1.0, [frame(9)]))

    done: list[float] = []
    sent = play(source, until_s=0.15, on_time=interrupt)
    assert [int.from_bytes(data, "big") for *_, data in sent] == [0, 9] and source.skipped == 2


def test_frames_on_paper_are_those_that_a_line_takes():
    times = [0.0, 0.02, 0.021, 0.04, 0.0401, 0.0402, 0.06]
    schedule = Schedule(times, [frame(n) for n in range(len(times))], 0.0)
    paper = list(on_the_line(schedule, BYTE_S, 0.0))
    sent = play(scheduled(times))
    assert [one.data for one in paper] == [data for *_, data in sent]
    assert [one.at_s + FRAME_S for one in paper] == pytest.approx([ends for _, ends, _, _ in sent])
    assert [one.number for one in paper] == [0, 1, 2, 3, 5, 6]


def test_no_more_sound_than_the_budget_gives():
    source = live(budget=SoundBudget(on_time_s=0.5))
    sent = play(source, until_s=2.0, on_time=fed(source, 0.02, 0.0, 2.0))
    stops = [at for at, _, _, data in sent if data == STOP]
    assert stops == [pytest.approx(0.5, abs=0.015)] and max(at for at, *_ in sent) == stops[0]
    source = live(budget=SoundBudget(duty=0.5, window_s=1.0))
    sent = play(source, until_s=6.0, on_time=fed(source, 0.02, 0.0, 6.0))
    on = 0.0
    for (at, _, _, data), (then, *_) in pairwise(sent):
        on += (then - at) * (data != STOP)
    assert on / 6.0 == pytest.approx(0.5, abs=0.1)
    assert "duty" in source.reason or source.reason == ""


def test_messages_come_back_as_they_were():
    schedule = Schedule([0.0, 0.25], [b"abc", b"de"], 1.5)
    back = Schedule.unpacked(schedule.packed())
    assert list(back.times_s) == [0.0, 0.25] and back.frames == [b"abc", b"de"] and back.duration_s == 1.5
    one = LiveFrame(12.5, 0.5, [b"ab", b"cd", b"ef"])
    assert LiveFrame.unpacked(one.packed()) == one
    timed = one._replace(due_s=12.75)
    assert LiveFrame.unpacked(timed.packed()) == timed
    job = Job("/dev/x", None, 18000.0, "a5", "a5", duty=0.25)
    assert Job.unpacked(job.packed()) == job
