"""What is wrong with a file, one finding at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import h5py

from gonio.errors import StoreError
from gonio.store.checked import Checked


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be: where in the file, what, and what to do."""

    place: str
    problem: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.place}: {self.problem}; {self.remedy}"


@dataclass(slots=True)
class Findings:
    """What a check has found so far in an open file."""

    parts: Checked
    found: list[Finding] = field(default_factory=list)

    def add(self, place: str, problem: str, remedy: str = "restore the file from a copy") -> None:
        """Note a finding at ``/place``."""
        self.found.append(Finding(f"/{place}", problem, remedy))

    def get(self, read: Callable[..., Any], place: str, *arguments: Any) -> Any:
        """Return what a method of `Checked` reads at a place; None and a finding if it cannot."""
        try:
            return read(place, *arguments)
        except StoreError as error:
            told = str(error).removeprefix(f"{self.parts.path}: is not a gonio scan: ")
            self.add(
                place, told.removesuffix("; give a file written by gonio scan").removeprefix(f"/{place} ")
            )
        except (OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError) as error:
            self.add(place, f"cannot be read ({error})")
        return None

    def attribute(self, place: str, name: str, expected: str | None = None) -> None:
        """Find fault with a text attribute that is missing or another than expected."""
        value = self.parts.attribute(place, name)
        if value == "" and expected != "":
            wanted = f"'{expected}'" if expected is not None else "a text"
            self.add(place, f"has no attribute {name}", f"set it to {wanted}")
        elif expected is not None and value != expected:
            self.add(place, f"attribute {name} is '{value}'", f"set it to '{expected}'")

    def group(self, place: str, nx_class: str) -> h5py.Group | None:
        """Return a group of a NeXus class; None and a finding if there is none."""
        group = self.get(self.parts.group, place)
        if group is None:
            return None
        self.attribute(place, "NX_class", nx_class)
        return group
