"""`gonio fit --budget`: what each stated cause contributes to the uncertainty of the results."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gonio.errors import ConfigError

if TYPE_CHECKING:  # `gonio --help` need not load them
    from gonio.fitting import FitResult
    from gonio.store import Scan

_MIDDLE = "middle"


@dataclass(frozen=True, slots=True)
class BudgetRequest:
    """At which wavelength the budget is shown, None for the middle, and how many trials check it."""

    wavelength_nm: float | None
    trials: int


def add_budget_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gonio fit` that have to do with the budget."""
    group = parser.add_argument_group("the uncertainty that all readings share")
    group.add_argument(
        "--budget",
        nargs="?",
        const=_MIDDLE,
        metavar="NM",
        help="print the budget of [uncertainty] in the rig file at the wavelength next to NM (the middle one "
        "without), and put it into the stored intervals",
    )
    group.add_argument(
        "--budget-trials",
        type=int,
        default=0,
        metavar="N",
        help="check the linear budget by N trials of a Monte Carlo (JCGM 101), 2000 or more",
    )


def budget_request(options: argparse.Namespace) -> BudgetRequest | None:
    """Return what the options ask for, None if no budget is asked for."""
    if options.budget is None:
        if options.budget_trials:
            raise ConfigError("--budget-trials checks a budget; give --budget too")
        return None
    if options.budget == _MIDDLE:
        return BudgetRequest(None, options.budget_trials)
    try:
        return BudgetRequest(float(options.budget), options.budget_trials)
    except ValueError:
        raise ConfigError(
            f"--budget {options.budget}: is no wavelength in nm; give a number, or nothing"
        ) from None


def with_budget(scan: Scan, fit: FitResult, request: BudgetRequest) -> tuple[FitResult, str]:
    """Return the fit with the budget in its uncertainties, and the budget as text."""
    from gonio.fitting.budget import budget
    from gonio.fitting.inputs import stated_in
    from gonio.fitting.jcgm101 import monte_carlo

    stated = stated_in(scan.rig_text)
    found = budget(fit, stated)
    text = found.table(request.wavelength_nm)
    if stated is None:
        text += (
            "\nthe scan's rig file has no [uncertainty] table: nothing was added to the fit's own uncertainty"
        )
    if request.trials:
        text += "\n\n" + monte_carlo(found, request.wavelength_nm, trials=request.trials).table()
    return found.fit, text
