"""Parse the command line and run one command; every user error becomes one message and exit code 1."""

from __future__ import annotations

import argparse
import importlib.metadata
import io
import os
import signal
import sys
from pathlib import Path
from types import FrameType

from gonio import __version__
from gonio.cli.budget import add_budget_options, budget_request
from gonio.cli.facade import add_facade_options, facade, facade_request
from gonio.cli.fit_options import add_fit_options, fit_request
from gonio.cli.sphere import add_sphere_options, sphere_request
from gonio.errors import GonioError, ScanStopped

ELSEWHERE = {
    "simulate": "start the wire simulators of the bench and print their addresses",
    "replay": "serve a wire log back as the devices it was recorded from, or print it",
    "gui": "open the acquisition window",
}


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands that live in the core package."""
    parser = argparse.ArgumentParser(
        prog="gonio", description="Measure, fit and use the BRDF of building materials.", allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"gonio {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser(
        "demo", help="the whole chain on the simulated ARTA: scan, HDF5, fit, facade, report"
    )
    demo.add_argument(
        "--out", type=Path, default=Path("gonio-demo"), metavar="DIR", help="folder (default: gonio-demo)"
    )
    demo.add_argument("--quick", action="store_true", help="a tenth of the wavelengths")
    _rig_option(demo)

    plan = commands.add_parser(
        "plan", help="dry run: check every position, estimate the time; exit 1 if any is refused"
    )
    plan.add_argument("plan", type=Path, metavar="PLAN.toml")
    _rig_option(plan)
    plan.add_argument(
        "--measure",
        action="store_true",
        help="connect to the rig and measure what an exchange takes, for the estimate; moves only the "
        "monochromator and its shutter",
    )

    scan = commands.add_parser("scan", help="acquire a scan, or resume one")
    scan.add_argument("plan", type=Path, nargs="?", metavar="PLAN.toml")
    scan.add_argument("-o", "--output", type=Path, metavar="FILE.h5")
    scan.add_argument("--resume", type=Path, metavar="FILE.h5", help="continue an interrupted scan")
    scan.add_argument(
        "--wire-log", type=Path, metavar="FILE", help="append every byte on the wire, with its time"
    )
    _policy_options(scan)
    _rig_option(scan)

    queue = commands.add_parser(
        "queue", help="several samples and plans one after the other; what is done is not measured again"
    )
    queue.add_argument("queue", type=Path, metavar="QUEUE.toml")
    queue.add_argument("--check", action="store_true", help="dry run of every scan; measure nothing")
    queue.add_argument(
        "--unattended", action="store_true", help="wait for nobody between samples, whatever the file says"
    )
    _policy_options(queue)
    _rig_option(queue)

    fit = commands.add_parser("fit", help="fit the BRDF, store it beside the data, print the table")
    fit.add_argument("scan", type=Path, metavar="FILE.h5")
    add_fit_options(fit)
    fit.add_argument("--compare", action="store_true", help="the four aperture models side by side")
    fit.add_argument("--models", action="store_true", help="all scattering models side by side")
    add_budget_options(fit)
    add_sphere_options(fit)

    facade_parser = commands.add_parser(
        "facade", help="irradiance of a street scene, with standard errors and contributions"
    )
    add_facade_options(facade_parser)

    report = commands.add_parser("report", help="figures and one HTML page of a scan or of a facade result")
    report.add_argument("file", type=Path, metavar="FILE.h5")
    report.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder (default: FILE-report)")
    report.add_argument(
        "--facade", type=Path, metavar="FACADE.h5", help="facade result to show in a scan's report"
    )

    check = commands.add_parser("check", help="is a file whole, and what gonio says it writes? exit 1 if not")
    check.add_argument("files", type=Path, nargs="+", metavar="FILE.h5")
    check.add_argument("--here", action="store_true", help=argparse.SUPPRESS)  # in this process

    devices = commands.add_parser("devices", help="what is connected and answering")
    devices.add_argument("--ports", action="store_true", help="list the serial ports of this machine instead")
    _rig_option(devices)

    for name, text in ELSEWHERE.items():
        commands.add_parser(name, help=text, add_help=False)
    return parser


def _policy_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--retries",
        type=int,
        metavar="N",
        help="further attempts at a position where a device failed (default 3)",
    )
    parser.add_argument(
        "--on-fault",
        choices=["pause", "skip", "abort"],
        help="what then (default: pause at a terminal, else abort; an aborted scan can be resumed)",
    )


def _rig_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rig", type=Path, metavar="RIG.toml", help="the rig (default: the simulated ARTA)")


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code."""
    arguments = sys.argv[1:] if argv is None else argv
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)  # in a log, results and progress in order
    if hasattr(signal, "SIGTERM"):
        signal.signal(signal.SIGTERM, _terminate)  # a service manager's stop ends as cleanly as Ctrl-C
    try:
        if arguments and arguments[0] in ELSEWHERE:
            return _run_elsewhere(arguments[0], arguments[1:])
        return _run(build_parser().parse_args(arguments))
    except ScanStopped as stop:
        print(f"\n{stop}", file=sys.stderr)
        return 130
    except GonioError as error:
        print(f"gonio: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ngonio: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `gonio fit ... | head`: the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _terminate(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _run(options: argparse.Namespace) -> int:
    # Each command is imported when it is asked for: `gonio --help` need not load numba.
    if options.command == "demo":
        from gonio.cli.demo import demo

        return demo(options.out, quick=options.quick, rig_file=options.rig)
    if options.command == "plan":
        from gonio.cli.dry_run import dry_run

        return dry_run(options.plan, options.rig, measure=options.measure)
    if options.command == "scan":
        from gonio.cli.acquisition import resume, scan
        from gonio.cli.attended import policy_of

        policy = policy_of(options.retries, options.on_fault)
        if (options.resume is None) == (options.plan is None):
            print("gonio scan: give PLAN.toml -o FILE.h5, or --resume FILE.h5", file=sys.stderr)
            return 2
        if options.resume is not None:
            if options.output is not None:
                print("gonio scan: --resume continues its own file; leave -o out", file=sys.stderr)
                return 2
            return resume(options.resume, options.rig, wire_log=options.wire_log, policy=policy)
        if options.output is None:
            print("gonio scan: where to? give -o FILE.h5", file=sys.stderr)
            return 2
        return scan(options.plan, options.rig, options.output, wire_log=options.wire_log, policy=policy)
    if options.command == "queue":
        from gonio.cli.attended import policy_of
        from gonio.cli.queue import run_queue

        return run_queue(
            options.queue,
            options.rig,
            check_only=options.check,
            unattended=options.unattended,
            policy=policy_of(options.retries, options.on_fault),
        )
    if options.command == "fit":
        from gonio.cli.analysis import fit

        return fit(
            options.scan,
            fit_request(options),
            compare=options.compare,
            models=options.models,
            sphere=sphere_request(options),
            budget=budget_request(options),
        )
    if options.command == "facade":
        return facade(facade_request(options))
    if options.command == "report":
        from gonio.cli.analysis import report

        return report(options.file, options.output, options.facade)
    if options.command == "check":
        from gonio.cli.check import check, check_here

        return check_here(options.files[0]) if options.here else check(options.files)
    if options.command == "devices":
        from gonio.cli.acquisition import devices

        if options.ports:
            return _run_elsewhere("ports", [])
        return devices(options.rig)
    raise AssertionError(options.command)


def _run_elsewhere(name: str, arguments: list[str]) -> int:
    """Run a command of another package, found by its entry point so that the core need not import it."""
    for point in importlib.metadata.entry_points(group="gonio.commands"):
        if point.name == name:
            return int(point.load()(arguments))
    raise GonioError(f"the command '{name}' is not installed; reinstall gonio")
