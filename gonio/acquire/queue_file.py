"""`queue.toml`: which samples are measured one after the other, with which plans, into which files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from gonio.config import Strict, read_toml, validate
from gonio.errors import ConfigError
from gonio.plan.model import Plan, load_plan
from gonio.plan.tables import a_list

WhenOneFails = Literal["stop", "next"]
Flag = Annotated[bool, Field(strict=True)]


class QueueEntry(Strict):
    """One ``[[scans]]`` table."""

    sample: str
    description: str | None = None
    plan: str
    output: str
    pause: Flag | None = None  # by default that of the queue


class QueueFile(Strict):
    """The whole file; paths are seen from its folder."""

    title: str = "Scan queue"
    rig: str | None = None
    pause: Flag = True
    when_one_fails: WhenOneFails = "stop"
    scans: Annotated[
        tuple[QueueEntry, ...], BeforeValidator(a_list("tables", "[[scans]]")), Field(min_length=1)
    ]


@dataclass(frozen=True, slots=True)
class QueuedScan:
    """One scan of a queue.

    Attributes
    ----------
    sample, plan, output
        Whose scan it is, what is measured (with the sample's name in it), and the `.h5`.
    pause
        Whether an operator is waited for before it, to put the sample in.
    """

    sample: str
    plan: Plan
    output: Path
    pause: bool = True


@dataclass(frozen=True, slots=True)
class QueueConfig:
    """A validated queue with its plans."""

    title: str
    rig: Path | None
    when_one_fails: WhenOneFails
    scans: tuple[QueuedScan, ...]


def load_queue(path: str | Path) -> QueueConfig:
    """Return the validated queue file with its plans; `ConfigError` lists the mistakes of the file, or of
    the first plan that has any.
    """
    path = Path(path)
    folder = path.absolute().parent
    table = validate(QueueFile, read_toml(path), source=str(path))
    scans: list[QueuedScan] = []
    taken: dict[Path, str] = {}
    for number, entry in enumerate(table.scans, start=1):
        output = folder / entry.output
        if output.suffix != ".h5":
            raise ConfigError(f"{path}: scans[{number}] output = '{entry.output}': give a name ending in .h5")
        if output.resolve() in taken:
            raise ConfigError(
                f"{path}: scans[{number}] output = '{entry.output}' is that of '{taken[output.resolve()]}' "
                "too; give each scan a file of its own"
            )
        taken[output.resolve()] = entry.sample
        plan = load_plan(folder / entry.plan)
        description = plan.sample.description if entry.description is None else entry.description
        sample = plan.sample.model_copy(update={"name": entry.sample, "description": description})
        pause = table.pause if entry.pause is None else entry.pause
        scans.append(QueuedScan(entry.sample, plan.model_copy(update={"sample": sample}), output, pause))
    rig = None if table.rig is None else folder / table.rig
    return QueueConfig(table.title, rig, table.when_one_fails, tuple(scans))
