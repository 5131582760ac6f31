"""`palmfield experiment`: trials on a board, with a person or a simulated observer, and what their log says."""

from pathlib import Path
from typing import Annotated

import typer

experiment = typer.Typer(
    name="experiment",
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Ask what is felt: play stimuli by a procedure, log every answer, and fit thresholds.\n\n"
    "An experiment is a TOML file: a scene, the key that is varied, conditions, a task and a procedure "
    "(docs/experiments.md). The same file serves a person at a real board, a virtual one, and simulated observers.\n\n"
    "Example: palmfield experiment run threshold.toml --log p01.jsonl --participant p01 --observer simulated",
)


@experiment.command("run")
def run_command(
    file: Annotated[Path, typer.Argument(help="the experiment, TOML or JSON", metavar="EXPERIMENT.toml")],
    log: Annotated[Path, typer.Option(help="where trials are logged; one that is there is gone on with")],
    participant: Annotated[str, typer.Option(help="who answers, as the log has it")],
    observer: Annotated[
        str, typer.Option(help="keyboard: a person here; simulated: of known threshold; skin: feels the simulated skin")
    ] = "keyboard",
    port: Annotated[
        str | None, typer.Option(help="of the board: /dev/ttyUSB0, COM3, socket://host:port, autd3:auto")
    ] = None,
    virtual: Annotated[bool, typer.Option("--virtual", help="a virtual board instead, to rehearse")] = False,
    board: Annotated[
        str | None, typer.Option(help="another board than the experiment's or the scene's", metavar="BOARD")
    ] = None,
) -> None:
    """Run an experiment's trials, from the first or from where its log ends.

    Each trial is on the disk before the next begins, with the moments at which its frames sounded: Ctrl-C, or q at the
    keyboard, loses none, and the same command goes on. A log of another design, scene, participant, observer or board
    is refused. Without --port and --virtual nothing is played, which is enough for simulated observers.

    Examples: palmfield experiment run threshold.toml --log p01.jsonl --participant p01 --port /dev/ttyUSB0

    palmfield experiment run threshold.toml --log skin.jsonl --participant skin --observer skin
    """
    from rich.console import Console

    from palmfield.studies.experiment.log import Trial
    from palmfield.studies.experiment.run import run_experiment

    screen = Console(stderr=True)

    def told(trial: Trial, average_s: float) -> None:
        content = trial.content
        screen.print(
            f"trial {trial.number + 1} {content['condition']} level {content['level']:.4g}: {content['answer']} "
            f"({'right' if content['right'] else 'wrong'}), {average_s:.1f} s a trial", highlight=False, markup=False,
        )  # fmt: skip

    try:
        done = run_experiment(
            file, log, participant=participant, observer=observer, port=port, virtual=virtual, board=board,
            on_trial=None if observer == "keyboard" else told,
        )  # fmt: skip
    except KeyboardInterrupt:
        screen.print(f"\ninterrupted; what was answered is in {log}, and the same command goes on", markup=False)
        raise typer.Exit(130) from None
    state = "finished" if done.finished else "ended early; the same command goes on"
    print(f"{log}: {done.trials} trials, {done.new} of them new; {state}")
    print(f"next: palmfield experiment report {log}")


@experiment.command("report")
def report_command(
    log: Annotated[Path, typer.Argument(help="of `palmfield experiment run`", metavar="LOG.jsonl")],
    png: Annotated[Path | None, typer.Option(help="draw runs and functions into this file")] = None,
    shape: Annotated[str, typer.Option(help="of the function: normal, logistic, weibull")] = "normal",
    lapse: Annotated[float, typer.Option(help="rate of lapses, 0 or more; below 0 it is found by the fit")] = 0.02,
    spread: Annotated[
        float | None, typer.Option(help="of the function, where it is known: dB of a scale of ratios [default: found]")
    ] = None,
    confidence: Annotated[float, typer.Option(help="of the intervals, between 0 and 1")] = 0.95,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON only, for other programs")] = False,
) -> None:
    """Print thresholds by condition with their intervals, of a log that is finished or not, and draw them.

    Example: palmfield experiment report p01.jsonl --png p01.png
    """
    import json
    from typing import cast, get_args

    from palmfield.errors import OutputError
    from palmfield.perception.psychometric import Shape
    from palmfield.studies.experiment.report import as_dict, as_text, report_of

    if shape not in get_args(Shape):
        raise OutputError(f"--shape has value '{shape}'; allowed: {', '.join(get_args(Shape))}")
    rate = None if lapse < 0.0 else lapse
    report = report_of(log, shape=cast(Shape, shape), lapse=rate, spread=spread, confidence=confidence)
    if png is not None:
        from palmfield.studies.experiment.picture import draw_report

        draw_report(report, png)
    print(json.dumps(as_dict(report), indent=2) if as_json else as_text(report))
    if png is not None and not as_json:
        print(f"wrote {png}")
