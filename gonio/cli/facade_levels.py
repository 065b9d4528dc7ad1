"""What does the material change in a scene?  `gonio facade SCENE.toml --levels`."""

from __future__ import annotations

import time
from pathlib import Path

from gonio.cli.progress import readable_duration
from gonio.errors import ConfigError


def facade_levels(scene_file: Path, *, rel_tol: float, seed: int, threads: int | None) -> int:
    """Print irradiance, difference to the highest level, and time, for each material level."""
    if not 1e-5 <= rel_tol <= 0.5:
        raise ConfigError(
            f"--rel-tol {rel_tol:g} is outside 1e-5...0.5; 0.01 asks for a standard error of 1 %"
        )
    from gonio.facade import load_scene
    from gonio.facade.levels import compare_levels

    scene = load_scene(scene_file)
    start = time.perf_counter()
    table = compare_levels(scene, rel_tol=rel_tol, seed=seed, threads=threads)
    print(table.text())
    for note in scene.notes:
        print(note)
    print(readable_duration(time.perf_counter() - start))
    return 0
