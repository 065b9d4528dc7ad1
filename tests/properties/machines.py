"""How long is a state machine let loose: the same examples in each run of the suite, more when asked."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, Phase, settings
from hypothesis.stateful import RuleBasedStateMachine, run_state_machine_as_test

RECOVERIES = 3
"""Attempts to recover once nothing is wrong any more: the first may only find out that the line is dead."""

MORE = int(os.environ.get("GONIO_PROPERTY_EXAMPLES", "0"))
"""Examples of each machine, random ones; without it there are few, and always the same."""


def run_machine(machine: type[RuleBasedStateMachine], *, max_examples: int) -> None:
    """Run a machine, and raise what it finds with the shortest example that shows it."""
    phases = [p for p in Phase if p is not Phase.shrink] if "GONIO_NO_SHRINK" in os.environ else list(Phase)
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=MORE or max_examples,
            stateful_step_count=20,
            derandomize=not MORE,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            phases=phases,
        ),
    )
