"""`palmfield experiment`: run trials on a board with a person or a simulated observer, and evaluate the log."""

from pathlib import Path
from typing import Annotated

import typer

from palmfield.cli.options import group

experiment = group(
    "experiment",
    "Run a psychophysical experiment: play stimuli by a procedure, log every answer, and fit thresholds.\n\nAn "
    "experiment is a TOML file: a scene, the varied key, conditions, a task and a procedure "
    "(docs/experiments.md). The same file works with a person at a real board, with a virtual board, and with "
    "simulated observers.\n\nExample: palmfield experiment run threshold.toml --log p01.jsonl --participant p01 "
    "--observer simulated",
)


@experiment.command("run")
def run_command(
    file: Annotated[Path, typer.Argument(help="file of the experiment, TOML or JSON", metavar="EXPERIMENT.toml")],
    log: Annotated[Path, typer.Option(help="log file of the trials; an existing log is continued")],
    participant: Annotated[str, typer.Option(help="name of the participant in the log")],
    observer: Annotated[
        str,
        typer.Option(
            help="keyboard: a person at this machine; simulated: an observer with a given threshold; skin: an observer "
            "of the simulated skin"
        ),
    ] = "keyboard",
    port: Annotated[
        str | None, typer.Option(help="port of the board: /dev/ttyUSB0, COM3, socket://host:port, autd3:auto")
    ] = None,
    virtual: Annotated[bool, typer.Option("--virtual", help="use a virtual board, for a rehearsal")] = False,
    board: Annotated[
        str | None, typer.Option(help="board to use in place of that of the experiment or scene", metavar="BOARD")
    ] = None,
) -> None:
    """Run the trials of an experiment, from the first trial or from where its log ends.

    Each trial is saved, with the times at which its frames sounded, before the next trial begins. So Ctrl-C, or key q,
    loses no trial, and the same command continues the experiment. A log of another design, scene, participant, observer
    or board is not accepted. Without --port and --virtual nothing is played, which suffices for simulated observers.

    Examples: palmfield experiment run threshold.toml --log p01.jsonl --participant p01 --port /dev/ttyUSB0

    palmfield experiment run threshold.toml --log skin.jsonl --participant skin --observer skin
    """
    from rich.console import Console

    from palmfield.studies.experiment.log import Trial
    from palmfield.studies.experiment.run import run_experiment

    screen = Console(stderr=True)

    def show_trial(trial: Trial, average_s: float) -> None:
        content = trial.content
        screen.print(
            f"trial {trial.number + 1} {content['condition']} level {content['level']:.4g}: {content['answer']} "
            f"({'right' if content['right'] else 'wrong'}), {average_s:.1f} s a trial", highlight=False, markup=False,
        )  # fmt: skip

    try:
        done = run_experiment(
            file, log, participant=participant, observer=observer, port=port, virtual=virtual, board=board,
            on_trial=None if observer == "keyboard" else show_trial,
        )  # fmt: skip
    except KeyboardInterrupt:
        screen.print(f"\ninterrupted; the answers are saved in {log}; repeat the command to continue", markup=False)
        raise typer.Exit(130) from None
    state = "finished" if done.finished else "ended early; repeat the command to continue"
    print(f"{log}: {done.trials} trials, {done.new} of them new; {state}")
    print(f"next: palmfield experiment report {log}")


@experiment.command("report")
def report_command(
    log: Annotated[Path, typer.Argument(help="log of `palmfield experiment run`", metavar="LOG.jsonl")],
    png: Annotated[Path | None, typer.Option(help="plot the runs and the psychometric functions to this file")] = None,
    shape: Annotated[str, typer.Option(help="shape of the function: normal, logistic, weibull")] = "normal",
    lapse: Annotated[
        float, typer.Option(help="lapse rate, 0 or more; a value below 0 lets the fit estimate it")
    ] = 0.02,
    spread: Annotated[
        float | None,
        typer.Option(
            help="spread of the function, if known; in dB for a logarithmic scale [default: estimated by the fit]"
        ),
    ] = None,
    confidence: Annotated[float, typer.Option(help="confidence level of the intervals, between 0 and 1")] = 0.95,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON only, for other programs")] = False,
) -> None:
    """Print and draw thresholds by condition, with intervals, from a complete or incomplete log.

    Example: palmfield experiment report p01.jsonl --png p01.png
    """
    import json
    from typing import cast, get_args

    from palmfield.errors import OutputError, refuse_unknown
    from palmfield.perception.psychometric import Shape
    from palmfield.studies.experiment.report import as_dict, as_text, report_of

    refuse_unknown(OutputError, "--shape has value {}", shape, get_args(Shape))
    rate = None if lapse < 0.0 else lapse
    report = report_of(log, shape=cast(Shape, shape), lapse=rate, spread=spread, confidence=confidence)
    if png is not None:
        from palmfield.studies.experiment.picture import draw_report

        draw_report(report, png)
    print(json.dumps(as_dict(report), indent=2) if as_json else as_text(report))
    if png is not None and not as_json:
        print(f"wrote {png}")
