"""A progress bar on what takes long; silent where nobody looks."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.filesize import pick_unit_and_suffix
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from experiments.support.long import Show


class SpeedColumn(ProgressColumn):
    """How much a second: chain steps, in a long run, else parts of a sweep."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        if speed is None:
            return Text("")
        unit, suffix = pick_unit_and_suffix(int(speed), ["", " k", " M", " G"], 1000)
        return Text(f"{speed / unit:.3g}{suffix}/s")


@contextmanager
def bars(console: Console) -> Iterator[Show]:
    """A function to call with (stage, done, total): a bar for each stage on a terminal, nothing elsewhere."""
    columns = [
        TextColumn("{task.description:<34}"),
        BarColumn(),
        SpeedColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    ]
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as progress:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=total)
            progress.update(tasks[stage], completed=done)

        yield show
