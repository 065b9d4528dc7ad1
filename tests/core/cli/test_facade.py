"""`gonio facade` as a user runs it: stop, go on, tighten, refuse; and what docs/facade.md tells to type."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gonio.cli.main import main
from gonio.facade import CONTRIBUTIONS, Irradiance, load_irradiance, load_scene, simulate

ROOT = Path(__file__).parents[3]
DOCS = (ROOT / "docs" / "facade.md").read_text(encoding="utf-8")
SCENE = (
    (ROOT / "examples" / "scenes" / "street.toml")
    .read_text(encoding="utf-8")
    .replace('scan = "hpl.h5"', "rho_d = 0.68\nrho_s = 1.0\nalpha = 80.0\nn2 = 1.5 #")
    .replace("band_nm", "# band_nm")
    .replace("rows = ", "rows = 2 # ")
    .replace("columns = ", "columns = 3 # ")
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "street.toml").write_text(SCENE, encoding="utf-8")
    (tmp_path / "street.toml").write_text(SCENE, encoding="utf-8")
    return tmp_path


def same_bits(a: Irradiance, b: Irradiance) -> bool:
    return a.rays == b.rays and all(
        np.array_equal(x.contributions[c].value, y.contributions[c].value)
        and np.array_equal(x.standard_error, y.standard_error)
        for x, y in zip(a.receivers, b.receivers, strict=True)
        for c in CONTRIBUTIONS
    )


def test_a_finished_result_is_tightened_in_its_place(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "results").mkdir()
    out = str(folder / "results" / "out.h5")
    once = ["--estimator", "paths", "--seed", "5"]
    assert main(["facade", "scenes/street.toml", "-o", out, "--rel-tol", "0.1", *once]) == 0
    first = load_irradiance(out)
    assert first.options["scene_folder"] == "../scenes"
    assert main(["facade", "--resume", out]) == 0
    assert "is finished at this tolerance" in capsys.readouterr().out
    assert main(["facade", "--resume", out, "--rel-tol", "0.02"]) == 0
    tight = load_irradiance(out)
    assert tight.converged
    assert (first.rel_tol, tight.rel_tol, tight.seed) == (0.1, 0.02, 5)
    assert first.rays < tight.rays
    assert same_bits(tight, simulate(load_scene("street.toml"), rel_tol=0.02, seed=5, estimator="paths"))
    assert main(["check", "--here", out]) == 0


def test_options_that_cannot_be_met(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["facade", "street.toml", "-o", "out.h5", "--rel-tol", "0.3"]) == 0
    cases = [
        (["street.toml"], 2, "where to? give -o OUT.h5"),
        ([], 2, "which scene? give SCENE.toml -o OUT.h5"),
        (["street.toml", "-o", "out.h5"], 1, "out.h5 exists already"),
        (["street.toml", "-o", "none/out.h5"], 1, "there is no folder none"),
        (["street.toml", "-o", "new.h5", "--rel-tol", "1.5"], 1, "--rel-tol 1.5 is not between 0 and 1"),
        (["street.toml", "-o", "new.h5", "--threads", "0"], 1, "threads = 0"),
        (["--resume", "out.h5", "--seed", "1"], 2, "--seed cannot be changed by --resume"),
        (["--resume", "out.h5", "-o", "new.h5"], 2, "-o cannot be changed by --resume"),
        (["--resume", "none.h5"], 1, "there is no such file"),
        (["street.toml", "--levels", "-o", "new.h5"], 2, "--levels prints a table and writes no file"),
    ]
    for arguments, code, message in cases:
        capsys.readouterr()
        assert main(["facade", *arguments]) == code, arguments
        assert message in capsys.readouterr().err, arguments
    assert sorted(p.name for p in folder.iterdir()) == ["out.h5", "scenes", "street.toml"]


def test_a_scene_that_has_changed_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["facade", "street.toml", "-o", "out.h5", "--rel-tol", "0.3", "--estimator", "paths"]
    assert main(arguments) == 0
    before = (folder / "out.h5").read_bytes()
    (folder / "street.toml").write_text(SCENE.replace("alpha = 80.0", "alpha = 81.0"), encoding="utf-8")
    assert main(["facade", "street.toml", "--resume", "out.h5", "--rel-tol", "0.1"]) == 1
    assert "simulate the scene anew" in capsys.readouterr().err
    assert (folder / "out.h5").read_bytes() == before


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C cannot be sent to one process there")
def test_ctrl_c_keeps_the_points_and_resume_goes_on(folder: Path) -> None:
    command = [sys.executable, "-m", "gonio.cli", "facade"]
    first = subprocess.Popen(
        [*command, "street.toml", "-o", "out.h5", "--rel-tol", "0.00002", "--estimator", "paths"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert first.stderr is not None
    first.stderr.readline()  # the engine is being prepared: the command has begun
    time.sleep(1.5)
    first.send_signal(signal.SIGINT)
    out, err = first.communicate(timeout=60)
    assert first.returncode == 130, err
    if "gonio: interrupted" in err:  # a machine so slow that there was no result yet
        assert not (folder / "out.h5").exists()
        return
    assert "go on with gonio facade --resume out.h5" in out
    stopped = load_irradiance("out.h5")
    assert stopped.interrupted
    tolerance = str(0.9 * stopped.relative_error)
    assert main(["facade", "--resume", "out.h5", "--rel-tol", tolerance]) == 0
    done = load_irradiance("out.h5")
    assert done.converged
    assert not done.interrupted
    assert done.rays > stopped.rays
    assert sorted(p.name for p in folder.iterdir()) == ["out.h5", "scenes", "street.toml"]


def test_the_commands_of_the_documentation_work(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands = [
        line for block in re.findall(r"```sh\n(.*?)```", DOCS, flags=re.DOTALL) for line in block.splitlines()
    ]
    assert len(commands) >= 5
    for line in commands:
        program, *arguments = shlex.split(line, comments=True)
        assert program == "gonio"
        assert main(arguments) == 0, (line, capsys.readouterr().err)
    assert (folder / "street-report" / "report.html").is_file()


def test_the_examples_of_the_documentation_work(folder: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", DOCS, flags=re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "docs/facade.md", "exec"), {})
