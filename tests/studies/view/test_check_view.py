"""The page of figures keeps other sections when one is made again."""

from check_view import Measured, Stretch, write


def test_a_section_is_replaced_and_others_stay(tmp_path):
    page = tmp_path / "view.md"
    alone, shown = Stretch(1000.0, 300.0, 0.0, 0.0, 1.0), Stretch(950.0, 309.0, 0.1, 15.0, 1.0)
    for device, rate in (("cpu", 15.0), ("cpu", 12.0)):
        write(Measured("a.xml", device, rate, [shown], [alone]), "command", page)
    write(Measured("b.xml", "cpu", 7.0, [shown], [alone]), "command", page)
    text = page.read_text()
    assert text.count("## a.xml on the CPU") == text.count("## b.xml on the CPU") == text.count("# Speed") == 1
    assert "12 pictures a second" in text and "15 pictures a second" not in text
    assert "+5.0%" in text and "+3.0%" in text
