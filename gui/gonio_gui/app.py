"""``gonio gui``: read the options, see whether a window can be opened here, and open it."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from gonio.errors import GonioError
from gonio.plan import Plan, load_plan
from gonio.rig import load_rig

if TYPE_CHECKING:
    from gonio_gui.window import MainWindow

SWITCH_S = 0.001
CLOSING_S = 10.0  # longest wait for the devices to be released when the application is ended from outside


def main(argv: list[str] | None = None) -> int:
    """Open the window and return the exit code when it is closed."""
    options = build_parser().parse_args(sys.argv[1:] if argv is None else argv)
    rig = load_rig(options.rig)
    plan = load_plan(options.plan) if options.plan is not None else Plan.paper()
    obstacle = explain_obstacle()
    if obstacle:
        print(f"gonio gui: {obstacle}", file=sys.stderr)
        return 1
    return _run(rig, plan, options.output)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of ``gonio gui``."""
    parser = argparse.ArgumentParser(
        prog="gonio gui",
        description="Open the acquisition window, by default on the simulated ARTA with the paper's plan.",
        allow_abbrev=False,
    )
    parser.add_argument("--rig", type=Path, metavar="RIG.toml", help="the rig (default: the simulated ARTA)")
    parser.add_argument("--plan", type=Path, metavar="PLAN.toml", help="the plan (default: the paper's)")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE.h5",
        help="the file to write, or an interrupted scan to resume (default: a new name in this folder)",
    )
    return parser


def needed_packages() -> list[str]:
    """Return the requirements of the extra ``gui``, as in pyproject.toml, for this Python."""
    qt = "PySide6-Essentials>=6.8,!=6.9.1"
    return [qt + ",<6.12" if sys.version_info < (3, 12) else qt, "pyqtgraph>=0.13.7"]


def explain_obstacle() -> str:
    """Return why no window can be opened here and what to do, empty if one can."""
    os.environ.setdefault("PYQTGRAPH_QT_LIB", "PySide6")
    for name in ("PySide6.QtWidgets", "pyqtgraph"):
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            if (error.name or "").split(".")[0] not in {"PySide6", "pyqtgraph", "shiboken6"}:
                raise
            packages = " ".join(f'"{package}"' for package in needed_packages())
            return (
                f"the window needs the package {(error.name or name).split('.')[0]}, which is not installed; "
                f"install it with\n    {sys.executable} -m pip install {packages}"
            )
        except ImportError as error:
            return (
                f"Qt cannot be loaded ({error}); on Debian or Ubuntu install what it needs with\n"
                "    apt-get install libglib2.0-0 libgl1 libegl1 libfontconfig1 libxkbcommon0 libdbus-1-3"
            )
    if sys.platform.startswith("linux") and not any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    ):
        # Qt would abort the process
        return "there is no display here to open a window on; log in on a desktop, or use gonio scan"
    return ""


def _run(rig: Any, plan: Plan, output: Path | None) -> int:
    from PySide6.QtWidgets import QApplication

    from gonio_gui.window import MainWindow

    # A drawing gives the interpreter up at every call of Qt and waits this long to get it back from the scan,
    # and the scan at every byte to get it back from a drawing; with the usual 5 ms both become sluggish.
    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    application = QApplication.instance() or QApplication(["gonio"])
    window = MainWindow(rig, plan, output)
    window.show()
    previous = _close_on_signals(window)
    try:
        code = int(application.exec())
    finally:
        sys.setswitchinterval(usual_s)
        for number, handler in previous.items():
            signal.signal(number, handler)
        window.bench.close()  # without effect after an orderly close; a desktop session may end us otherwise
        window.bench.join(CLOSING_S)
    return code


def _close_on_signals(window: MainWindow) -> dict[int, Any]:
    """Let Ctrl-C and SIGTERM close the window in order; its timer gives Python the time to see them."""

    def close(_signal: int, _frame: FrameType | None) -> None:
        window.shut_down()

    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM") if hasattr(signal, name)]
    return {number: signal.signal(number, close) for number in numbers}


if __name__ == "__main__":
    try:
        sys.exit(main())
    except GonioError as problem:
        print(f"gonio gui: {problem}", file=sys.stderr)
        sys.exit(1)
