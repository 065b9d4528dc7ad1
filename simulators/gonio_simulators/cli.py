"""`gonio simulate`: start the simulated bench, print its addresses, and serve until told to stop.

Prints one line ``ROLE PROTOCOL ADDRESS`` per port, then ``ready``.  Exit codes: 0 when told to stop, 1 with
a message, 2 for bad usage.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import os
import sys
from pathlib import Path
from typing import Any

from gonio.config import parse_toml, read_toml
from gonio.errors import ConfigError, GonioError
from gonio.rig import default_rig_text
from gonio_simulators.bench.bench import Bench
from gonio_simulators.bench.config import BenchConfig
from gonio_simulators.ending import stop_when_told
from gonio_simulators.faults import FaultLog, fault_table, parse_fault
from gonio_simulators.faults.injector import Injector
from gonio_simulators.wire.lines import PtyPort, new_event_loop
from gonio_simulators.wire.serve import Served, plan_ports, serve


def main(argv: list[str] | None = None) -> int:
    """Run `gonio simulate` and return its exit code."""
    options = _parser().parse_args(argv)
    if options.list_faults:
        print(fault_table())
        return 0
    try:
        tables, source = _tables(options)
        config = BenchConfig.from_tables(tables, source=source)
        _write_spectra(config, options)
        if options.pty and not PtyPort.is_available():
            raise ConfigError("--pty: this system has no pseudo-terminals; use the TCP addresses")
        bench = Bench.from_config(config)
        injector = _injector(bench, source)
        try:
            ports = plan_ports(bench, tables, with_pty=options.pty, source=source, injector=injector)
            with asyncio.Runner(loop_factory=new_event_loop) as runner:
                runner.run(_serve(ports, options, injector))
        finally:
            if injector is not None:
                injector.log.close()
                with contextlib.suppress(OSError):  # whoever started this may be gone
                    print(injector.log.summary(), file=sys.stderr)
    except GonioError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  # the exit flushes it once more
        print(
            "standard output was closed before the addresses were printed; read it to the end",
            file=sys.stderr,
        )
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="gonio simulate", description="Serve the simulated bench of a rig file on loopback ports."
    )
    parser.add_argument(
        "rig", nargs="?", type=Path, metavar="RIG.toml", help="default: the built-in simulated ARTA"
    )
    parser.add_argument("--seconds", type=_positive, metavar="N", help="stop after N real seconds")
    parser.add_argument(
        "--pty", action="store_true", help="serve each line on a pseudo-terminal, too (POSIX)"
    )
    parser.add_argument("--clock-speed", type=_positive, metavar="X", help="bench seconds per real second")
    parser.add_argument(
        "--seed", type=_whole, metavar="N", help="seed of noise, drift and the sphere's error"
    )
    parser.add_argument("--truth", type=Path, metavar="FILE.csv", help="write what is true on the bench")
    parser.add_argument(
        "--sphere", type=Path, metavar="FILE.csv", help="write the integrating sphere's spectrum"
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[@TARGET]:WHEN[:KEY=VALUE...]",
        help="inject a fault, such as late-reply:0.01 or stall@theta_mes:nth=3; repeatable",
    )
    parser.add_argument("--fault-log", type=Path, metavar="FILE", help="append a line per injected fault")
    parser.add_argument("--list-faults", action="store_true", help="print the faults there are, and end")
    parser.add_argument("--until-stdin-closes", action="store_true", help="stop at the end of standard input")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} must be a number above zero")
    return value


def _whole(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} must be a whole number, zero or above")
    return value


def _tables(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """The rig file's raw tables with the options applied, and what to call the file in messages."""
    if options.rig is None:
        source = "arta.toml (built in)"
        tables = parse_toml(default_rig_text(), source=source)
    else:
        source = str(options.rig)
        tables = read_toml(options.rig)
    simulation = tables.get("simulation")
    if isinstance(simulation, dict):
        if options.clock_speed is not None:
            simulation["clock_speed"] = options.clock_speed
        if options.seed is not None:
            simulation["seed"] = options.seed
        if options.fault and isinstance(simulation.setdefault("faults", []), list):
            simulation["faults"] = simulation["faults"] + options.fault
        if options.fault_log is not None:
            simulation["fault_log"] = str(options.fault_log)
    return tables, source


def _injector(bench: Bench, source: str) -> Injector | None:
    """Return what injects the faults that are asked for, None for none."""
    simulation = bench.config.simulation
    if not simulation.faults:
        return None
    try:
        specs = [parse_fault(text) for text in simulation.faults]
        log = FaultLog(Path(simulation.fault_log) if simulation.fault_log is not None else None)
        return Injector(specs, bench, log)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None


def _write_spectra(config: BenchConfig, options: argparse.Namespace) -> None:
    if options.truth is None and options.sphere is None:
        return
    from gonio_simulators.bench.truth import write_sphere, write_truth

    try:
        if options.truth is not None:
            write_truth(options.truth, config)
        if options.sphere is not None:
            write_sphere(options.sphere, config)
    except OSError as error:
        raise ConfigError(
            f"{error.filename}: cannot be written ({error.strerror}); choose another file"
        ) from None


async def _serve(ports: list[Served], options: argparse.Namespace, injector: Injector | None) -> None:
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    stop_when_told(loop, stop, until_stdin_closes=options.until_stdin_closes, seconds=options.seconds)
    if injector is not None:
        injector.start()
    await serve(ports, stop, announce=_announce)


def _announce(ports: list[Served]) -> None:
    for served in ports:
        print(served)
    print("ready", flush=True)
    gc.collect()
    gc.freeze()  # what lives now lives to the end; later collections need not look at it
