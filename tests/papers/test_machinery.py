"""How numbers are held, told and written: a made-up paper whose answers are known."""

import json
import math
from dataclasses import replace

import pytest

from palmfield.errors import MeasurementError, PalmfieldError, SceneError
from palmfield_papers import run as running
from palmfield_papers.answer import Answer, Cause, Paper, Picture, Setting
from palmfield_papers.counts import counts, noticed, turned_later, unsure, untested
from palmfield_papers.entries import Book, Control, Entry, Tolerance, book
from palmfield_papers.index import as_html
from palmfield_papers.page import page, row_text
from palmfield_papers.registry import paper
from palmfield_papers.rows import row
from palmfield_papers.verdicts import compared, distance_in_tolerances, verdict

RELATIVE = Tolerance("missing_inputs", "relative", 0.25)
YES_NO = Tolerance("yes_no", "inequality", 0.0)


def entry(
    name, *, value=10.0, kind="CLAIM", tolerance=RELATIVE, readings=("size",), sensitive=("half",), testable=True
):
    return Entry(
        id=name, row=name[:-1], paper="Nobody 2020", quantity="a length", unit="mm", value=value, column="measured",
        kind=kind, configuration="nobody.all", tolerance=tolerance, readings=readings, sensitive_to=sensitive,
        testable=testable, reason="made up", source="nowhere", condition="ours > 1" if tolerance is YES_NO else None,
    )  # fmt: skip


def book_of(*entries):
    control = Control("half", "All is halved.", ("nobody.all",), tuple(one.id for one in entries if one.sensitive_to))
    axes = {"size": ("small", "large")}
    return Book(entries, axes, {"size": "nowhere"}, (control,), {}, {}, ())


def nobody(answers, **more):
    return Paper("nobody2020", "Nobody 2020", "Nobody, nowhere", "A made-up paper.", answers, **more)


def by_size(small, large):
    def compute(setting):
        value = {"small": small, "large": large}[setting.reading("size")]
        return Answer(0.5 * value if setting.control == "half" else value, 0.01)

    return compute


@pytest.mark.parametrize(
    ("ours", "paper", "kind", "value", "distance"),
    [
        (10.0, 10.0, "relative", 0.25, 1.0),
        (12.5, 10.0, "relative", 0.25, 0.0),
        (-12.5, -10.0, "relative", 0.25, 0.0),
        (15.0, 10.0, "relative", 0.25, -1.0),
        (0.5, 1.0, "factor", 2.0, 0.0),
        (2.0, 1.0, "factor", 2.0, 0.0),
        (-math.sqrt(2.0), -1.0, "factor", 2.0, 0.5),
        (43.1, 45.6, "absolute_degrees", 5.0, 0.5),
        (-31.0, -34.0, "dB", 3.0, 0.0),
    ],
)
def test_distance_is_one_at_a_hit_and_zero_at_the_limit(ours, paper, kind, value, distance):
    assert distance_in_tolerances(ours, paper, kind, value) == pytest.approx(distance, abs=1e-9)


def test_a_factor_asks_for_the_sign():
    assert distance_in_tolerances(0.58, -0.58, "factor", 2.0) == -math.inf


def test_an_inequality_is_held_by_its_margin():
    asked = entry("N1a", value=1.0, tolerance=YES_NO)
    assert compared(asked, Answer(1.2, margin=0.2)).within
    assert not compared(asked, Answer(0.9, margin=-0.1)).within
    with pytest.raises(MeasurementError, match=r"N1a.*no margin"):
        compared(asked, Answer(1.2))


def test_a_range_is_met_all_over_and_missed_by_what_lies_beyond_its_end():
    asked = entry("N1a", value=[11.0, 12.0], tolerance=Tolerance("stated_inputs", "relative", 0.1))
    assert compared(asked, Answer(11.3)).distance == 1.0
    assert compared(asked, Answer(13.0)).distance == pytest.approx(1.0 - 10.0 / 12.0)
    assert not compared(asked, Answer(9.8)).within


def test_a_reading_may_hold_another_printed_number():
    asked = entry("N1a", value=10.0)
    assert not compared(asked, Answer(7.0)).within
    assert compared(asked, Answer(7.0, against=8.0)).distance == pytest.approx(0.5)


def test_an_answer_without_a_number_says_why():
    with pytest.raises(ValueError, match="note"):
        Answer(None)
    with pytest.raises(ValueError, match="nan"):
        Answer(math.nan)
    assert compared(entry("N1a"), Answer(None, note="outside the table")) is None


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((10.0, 11.0), "agrees"), ((10.0, 20.0), "depends"), ((20.0, 10.0), "depends"), ((20.0, 30.0), "disagrees"),
    ],
)  # fmt: skip
def test_readings_make_the_verdict(values, said):
    one = entry("N1a")
    came = row(one, nobody({"N1a": by_size(*values)}), book_of(one), Setting())
    assert came.verdict == said
    assert [tried.readings["size"] for tried in came.tried] == ["small", "large"]


def test_a_reading_without_a_value_says_nothing_and_a_base_without_one_leaves_no_answer():
    one = entry("N1a")
    inside, none = compared(one, Answer(10.0)), None
    assert verdict(one, [inside, none]) == "agrees"
    assert verdict(one, [none, inside]) == "no answer"
    assert verdict(replace(one, testable=False), [inside]) == "not testable"


def test_each_axis_is_varied_by_itself_from_the_base():
    held = book()
    [one] = [found for found in held.entries if found.id == "C14c"]
    readings = held.varied(one)
    base = dict(readings[0])
    assert base == {"chilles_sides": "fixed", "chilles_filter_order": "2", "chilles_start": "pure step"}
    assert len(readings) == 1 + 3 + 2 + 1
    assert all(sum(dict(other)[axis] != base[axis] for axis in base) == 1 for other in readings[1:])


def test_a_control_that_turns_what_it_lists_works_and_one_that_does_not_fails():
    near, far = entry("N1a", readings=("size",)), entry("N2a", readings=("size",))
    held = book_of(near, far)
    # Half of 10 is outside of 25 % of 10; half of 20 is inside, while 20 was not
    turned = nobody({"N1a": by_size(10.0, 10.0), "N2a": by_size(20.0, 20.0)})
    rows = [row(one, turned, held, Setting()) for one in (near, far)]
    [seen] = noticed(held.controls, rows)
    assert (seen.turned, seen.kept, seen.works) == (("N1a", "N2a"), (), True)
    deaf = nobody({name: lambda setting: Answer(10.0) for name in ("N1a", "N2a")})
    rows = [row(one, deaf, held, Setting()) for one in (near, far)]
    [seen] = noticed(held.controls, rows)
    assert (seen.turned, seen.works) == ((), False)
    assert untested(rows) == ["N1a", "N2a"]


@pytest.mark.parametrize(
    ("ours", "error", "said", "loose"),
    [
        ((12.4, 10.0), 0.2, "agrees", True), ((12.4, 10.0), 0.05, "agrees", False),
        ((12.6, 30.0), 0.2, "disagrees", True),
        ((12.6, 10.0), 0.2, "depends", True), ((12.4, 30.0), None, "depends", False),
    ],
)  # fmt: skip
def test_a_verdict_within_the_numerical_error_is_told(ours, error, said, loose):
    one = entry("N1a")

    def answer(setting):
        return Answer(dict(small=ours[0], large=ours[1])[setting.reading("size")], error)

    came = row(one, nobody({"N1a": answer}), book_of(one), Setting())
    assert came.verdict == said and unsure([came]) == (["N1a"] if loose else [])
    sentence = "Verdicts that another number within the numerical error would change: N1a."
    assert (sentence in page(nobody({}), book_of(one), [came], [], "", "made")) == loose


def test_causes_are_tested_only_where_a_claim_disagrees():
    one = entry("N1a")
    causes = {"N1a": (Cause("the other size", lambda setting: Answer(10.0)),)}
    said = {
        value: row(one, nobody({"N1a": by_size(value, value)}, causes=causes), book_of(one), Setting())
        for value in (10.0, 30.0)
    }
    assert said[10.0].causes == ()
    [(what, tried)] = said[30.0].causes
    assert what == "the other size" and tried.comparison.within


def test_what_was_written_later_is_told_apart_from_controls():
    one = entry("N1a", sensitive=())
    held = replace(book_of(one), controls=())
    later = {"N1a": (Cause("thrice", lambda setting: Answer(30.0)), Cause("the same", lambda setting: Answer(10.5)))}
    came = row(one, nobody({"N1a": by_size(10.0, 10.0)}, later=later), held, Setting())
    assert [came.differs(tried) for _, tried in came.later] == [True, False]
    assert (untested([came]), turned_later([came])) == (["N1a"], ["N1a"])
    assert [one["turned"] for one in came.as_dict()["later"]] == [True, False]
    text = page(nobody({}), held, [came], [], "", "made")
    assert "Of these 1 are turned by controls that were written later: N1a" in text and "| thrice |" in text
    # where a listed control turns it, nothing else is tried
    listed = entry("N1a")
    assert row(listed, nobody({"N1a": by_size(10.0, 10.0)}, later=later), book_of(listed), Setting()).later == ()


def test_a_row_that_fails_costs_neither_page_nor_rows(tmp_path, monkeypatch, caplog):
    good, bad, given = entry("N1a"), entry("N2a"), entry("N3a", kind="INPUT", readings=(), sensitive=())
    never = entry("N4a", testable=False)
    drawn = []

    def broken(setting):
        raise ZeroDivisionError("by nothing")

    def figure(setting):
        from matplotlib.figure import Figure

        drawn.append(setting)
        return Figure(figsize=(1.0, 1.0))

    def no_figure(setting):
        raise RuntimeError("no ink")

    made = nobody(
        {"N1a": by_size(10.0, 20.0), "N2a": broken},
        pictures=(Picture("one", "A picture.", figure), Picture("two", "No picture.", no_figure)),
        notes=lambda setting: "A note.",
    )
    monkeypatch.setattr(running, "paper", lambda name: made)
    monkeypatch.setattr(running, "book", lambda: book_of(good, bad, given, never))
    monkeypatch.setattr("palmfield_papers.index.NAMES", ("nobody2020",))
    [done] = running.papers(["nobody2020"], out=tmp_path)
    assert done.failed == ("N2a",)
    assert done.verdicts == {"agrees": 0, "disagrees": 0, "depends": 1, "not testable": 1, "no answer": 1}
    folder = tmp_path / "nobody2020"
    table = json.loads((folder / "rows.json").read_text())
    rows = {one["id"]: one for one in table["rows"]}
    assert rows["N1a"]["verdict"] == "depends" and rows["N1a"]["tried"][1]["ours"] == 20.0
    assert rows["N2a"]["tried"][0]["note"] == "ZeroDivisionError: by nothing"
    text = (folder / "README.md").read_text()
    for words in ("A made-up paper.", "**failed:** ZeroDivisionError", "one.png", "A note.", "as given"):
        assert words in text
    assert "two.png" not in text and "figure two failed" in caplog.text
    assert "<table>" in (folder / "index.html").read_text()
    assert "nobody2020/index.html" in (tmp_path / "index.html").read_text()
    assert len(drawn) == 1


def test_numbers_alone_are_told_under_their_readings(monkeypatch):
    first, second = entry("N1a"), entry("N2a")
    answers = {"N1a": by_size(10.0, 20.0), "N2a": by_size(10.0, 10.0)}
    monkeypatch.setattr(running, "TITLES", {"nobody2020": "Nobody 2020"})
    monkeypatch.setattr(running, "paper", lambda name: nobody(answers))
    monkeypatch.setattr(running, "book", lambda: book_of(first, second))
    [one] = running.numbers(["N1a"])
    text = row_text(one)
    assert "N1a a length: 10 mm, measured; depends" in text
    assert "size: large: 20 (error 0.01" in text and "control half: 5 " in text
    with pytest.raises(SceneError, match="N9z"):
        running.numbers(["N9z"])


def test_ctrl_c_leaves_a_page_of_what_is_done(tmp_path, monkeypatch):
    def stopped(setting):
        raise KeyboardInterrupt

    made = nobody({"N1a": by_size(10.0, 10.0), "N2a": stopped, "N3a": by_size(10.0, 10.0)})
    monkeypatch.setattr(running, "paper", lambda name: made)
    monkeypatch.setattr(running, "book", lambda: book_of(entry("N1a"), entry("N2a"), entry("N3a")))
    with pytest.raises(KeyboardInterrupt):
        running.papers(["nobody2020"], out=tmp_path)
    rows = json.loads((tmp_path / "nobody2020" / "rows.json").read_text())["rows"]
    assert [one["id"] for one in rows] == ["N1a"]
    assert "interrupted" in (tmp_path / "nobody2020" / "README.md").read_text()


def test_counts_have_every_verdict():
    one = entry("N1a")
    rows = [row(one, nobody({"N1a": by_size(10.0, 10.0)}), book_of(one), Setting())]
    assert counts(rows) == {"agrees": 1, "disagrees": 0, "depends": 0, "not testable": 0, "no answer": 0}


def test_less_than_one_job_and_an_unknown_device_are_refused(tmp_path):
    with pytest.raises(SceneError, match="jobs is 0"):
        running.papers(["mizushima2024"], out=tmp_path, jobs=0)
    with pytest.raises(PalmfieldError, match="device 'gpu9'"):
        running.papers(["mizushima2024"], out=tmp_path, device="gpu9")


def test_an_unknown_paper_is_named_with_what_was_meant():
    with pytest.raises(SceneError, match=r"chiles2019.*chilles2019"):
        paper("chiles2019")


@pytest.mark.smoke
def test_tables_become_html():
    text = as_html("Title", "# Head\n\n| a | b |\n|---|---|\n| 1 | **2** |\n", home=True)
    assert "<td>1</td>" in text and "<strong>2</strong>" in text and "<title>Title</title>" in text
    assert 'href="../index.html"' in text
