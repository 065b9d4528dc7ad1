"""Feeds a target many inputs; each input has a seed of its own, so that any one can be repeated alone."""

from __future__ import annotations

import time
from random import Random

from fuzzing.outcome import Tally, Target
from fuzzing.virtual_time import VirtualTime

RESTART = 1000
"""Inputs after which a target is made anew: what went wrong before must not hide what goes wrong later."""


def run(make: type[Target], n_inputs: int, seed: int) -> Tally:
    """Return the counts of `n_inputs` inputs to a target.

    The inputs come in blocks of `RESTART`, each with a new target and a generator of its own; an example
    names block and place, and `run_block` repeats it.
    """
    tally = Tally(make.name)
    began_s = time.perf_counter()
    for block in range(-(-n_inputs // RESTART)):
        run_block(make, seed, block, min(RESTART, n_inputs - block * RESTART), tally)
    tally.seconds = time.perf_counter() - began_s
    return tally


def run_block(make: type[Target], seed: int, block: int, n_inputs: int, tally: Tally) -> None:
    """Feed one block of inputs."""
    rng = Random(f"{make.name} {seed} {block}")
    virtual = VirtualTime()
    with virtual.installed():
        target = make(virtual)
        for i in range(n_inputs):
            where = f"{make.name} seed {seed} block {block} input {i}"
            try:
                result = target.one(rng)
            except Exception as error:  # a target hands back the errors that it expects
                tally.add_unexpected(error, where)
                target = make(virtual)
            else:
                tally.add(result, where)
