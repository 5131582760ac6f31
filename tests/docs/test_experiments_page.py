"""docs/experiments.md: its example runs, with a simulated observer and without a board, and ends as the page says."""

import re
from pathlib import Path

from palmfield.studies.experiment.report import as_text, report_of
from palmfield.studies.experiment.run import run_experiment

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "experiments.md").read_text()


def test_the_example_runs_and_ends_as_the_page_says(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    (told,) = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
    (tmp_path / "mjcf").symlink_to(ROOT / "mjcf")
    (tmp_path / "threshold.toml").write_text(text)
    log = tmp_path / "p01.jsonl"
    done = run_experiment(tmp_path / "threshold.toml", log, participant="p01", observer="simulated")
    assert done.finished
    # Digits of a fit may differ between machines in the last place
    numbers = r"\d+\.\d+"
    seen = as_text(report_of(log))
    assert re.sub(numbers, "#", seen) == re.sub(numbers, "#", told.strip())
    for own, page in zip(re.findall(numbers, seen), re.findall(numbers, told), strict=True):
        assert abs(float(own) - float(page)) <= 0.02 * float(page)


def test_all_keys_of_an_experiment_are_on_the_page():
    from palmfield.studies.experiment.design import KINDS, Design, Simulated, SkinObserver, Task, Trigger, Varied

    words = set(re.findall(r"`\[*([a-z_]+)", PAGE)) | set(re.findall(r"^\[+(\w+)\]", PAGE, flags=re.MULTILINE))
    for part in (Design, Varied, Task, Simulated, SkinObserver, Trigger):
        assert set(part.model_fields) <= words, set(part.model_fields) - words
    for kind in KINDS.values():
        own = set(kind.__dataclass_fields__) - {"seed"}
        assert own <= words, own - words
