"""Does any text or bytes make a parser hang, raise what nobody expects, or accept what was never said?

Replies of every protocol (true ones, damaged, of other devices, late, in pieces) go to the drivers, damaged
requests to the simulators, damaged files to their readers, in virtual time; see `benchmarks/fuzzing/`.

right         accepted, and what was said (simulators: answered; files: read)
valid         accepted, and something else was said in a frame with a right checksum: made so on purpose
              (forged), or by chance, which CRC16 lets happen once in 65536 damaged frames and a sum of bytes
              once in 256
copies        accepted, a whole old reply that came once more: nothing in Modbus RTU tells it
unprotected   accepted, and something else was said, where the protocol has no checksum: form, echo,
              read-back and range did not notice
absurd        accepted, not a number or beyond the instrument: must be 0
corrupt       accepted although no right checksum says so, or answered for another device: must be 0
unexpected    raised something that is not a gonio error: must be 0

Run: python benchmarks/fuzz.py [--inputs N] [--seed S] [--only WORD]
Exit code 1 if one of the three is not 0.
"""

from __future__ import annotations

import argparse
import sys

from fuzzing.outcome import Tally, Verdict
from fuzzing.run import run
from fuzzing.targets import SHARES


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--inputs", type=int, default=1_050_000, metavar="N", help="in all (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=2022, metavar="S", help="repeats a run (default: %(default)s)"
    )
    parser.add_argument("--only", default="", metavar="WORD", help="targets whose name contains it")
    options = parser.parse_args()
    targets = {target: share for target, share in SHARES.items() if options.only in target.name}
    if not targets:
        parser.error(
            f"no target's name contains '{options.only}'; targets: {', '.join(t.name for t in SHARES)}"
        )
    whole = sum(targets.values())
    print(
        f"{'target':<21}{'inputs':>9}{'right':>9}{'refused':>9}{'valid (forged)':>16}{'copies':>8}"
        f"{'unprot.':>9}{'absurd':>8}{'corrupt':>9}{'unexp.':>8}{'reads':>7}{'s':>6}"
    )
    tallies = []
    for target, share in targets.items():
        tally = run(target, max(1, round(options.inputs * share / whole)), options.seed)
        tallies.append(tally)
        print(_row(tally), flush=True)
    inputs, seconds = sum(t.inputs for t in tallies), sum(t.seconds for t in tallies)
    defects = sum(t.defects for t in tallies)
    print(f"\n{inputs} inputs in {seconds:.0f} s, {defects} defects")
    for tally in tallies:
        if tally.refused:
            print(f"  {tally.name} refused: " + ", ".join(f"{k} {n}" for k, n in tally.refused.most_common()))
    for example in (e for t in tallies for e in t.examples):
        print(example)
    return 1 if defects else 0


def _row(tally: Tally) -> str:
    verdicts = tally.verdicts
    valid = f"{verdicts[Verdict.VALID_OTHER]} ({tally.forged})"
    right = verdicts[Verdict.RIGHT] + verdicts[Verdict.EARLIER]
    return (
        f"{tally.name:<21}{tally.inputs:>9}{right:>9}{sum(tally.refused.values()):>9}{valid:>16}"
        f"{verdicts[Verdict.UNASKED]:>8}{verdicts[Verdict.UNPROTECTED]:>9}{verdicts[Verdict.ABSURD]:>8}"
        f"{verdicts[Verdict.CORRUPT]:>9}{sum(tally.unexpected.values()):>8}{tally.most_reads:>7}{tally.seconds:>6.0f}"
    )


if __name__ == "__main__":
    sys.exit(main())
