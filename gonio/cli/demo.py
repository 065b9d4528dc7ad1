"""`gonio demo`: the whole chain on the simulated ARTA.

Nothing is shortened or made up: the simulator is another process, every reading travels over its ports, the
scan is an ordinary scan, and each following step reads the file that the step before it has written.
"""

from __future__ import annotations

import time
from importlib import resources
from pathlib import Path

from gonio.acquire.journal import journal_path
from gonio.bench_process import served
from gonio.cli.acquisition import acquire, continue_scan, refuse_bad_plan
from gonio.cli.analysis import fit_table
from gonio.cli.progress import progress_bar, readable_duration
from gonio.cli.sphere import sphere_text
from gonio.errors import ConfigError, StoreError
from gonio.plan import Plan, estimate
from gonio.rig import RigConfig, load_rig
from gonio.store import attach_csv_spectrum, load

QUICK_STEP_NM = 100.0


def demo(folder: Path, *, quick: bool, rig_file: Path | None) -> int:
    """Measure, fit, simulate a street and report, all in `folder`."""
    start = time.perf_counter()
    rig = load_rig(rig_file)
    if not rig.is_simulated():
        raise ConfigError(
            f"rig '{rig.name}' has real addresses, and the demo runs on the simulated bench only; set every "
            'address to "simulated", or measure with gonio scan'
        )
    plan = demo_plan(quick=quick)
    refuse_bad_plan(plan, rig)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"{folder}: cannot be made ({error.strerror}); choose another folder with --out"
        ) from None
    (folder / "plan.toml").write_text(plan.to_toml(), encoding="utf-8")
    (folder / "rig.toml").write_text(rig.text, encoding="utf-8")
    (folder / "street.toml").write_text(_data("street.toml"), encoding="utf-8")

    _measure(plan, rig, folder / "hpl.h5")
    _fit(folder / "hpl.h5")
    _facade(folder / "street.toml", folder / "facade.h5")
    page = _report(folder / "hpl.h5", folder / "facade.h5", folder / "report")
    print(f"\nDone in {readable_duration(time.perf_counter() - start)}. Open {page}")
    print(
        f"The data: {folder / 'hpl.h5'} and {folder / 'facade.h5'}; plan, rig and scene stand beside them "
        "to play with."
    )
    return 0


def demo_plan(*, quick: bool) -> Plan:
    """Return the paper's plan, or with fewer wavelengths for a quick look."""
    plan = Plan.paper()
    if not quick:
        return plan
    wavelengths = tuple(block.model_copy(update={"step_nm": QUICK_STEP_NM}) for block in plan.wavelengths)
    return plan.model_copy(update={"wavelengths": wavelengths})


def _measure(plan: Plan, rig: RigConfig, path: Path) -> None:
    interrupted = journal_path(path).exists()
    if path.exists() and not interrupted:
        path.unlink()  # an earlier demo's, simulated like this one
    truth_csv, sphere_csv = path.with_name("truth.csv"), path.with_name("sphere.csv")
    with served(rig, truth_csv=truth_csv, sphere_csv=sphere_csv) as reachable:
        print("1  The simulated ARTA answers:")
        for role, address in reachable.addresses().items():
            print(f"     {role:<14}{address}")
        print(
            f"2  {len(plan.positions())} positions x {len(plan.wavelength_nm)} wavelengths over the wire, "
            f"{readable_duration(estimate(plan, rig))} of bench time at {rig.clock_speed():g} x"
        )
        if interrupted:
            print(f"     {path} was interrupted; it is resumed")
            continue_scan(path, reachable)
        else:
            acquire(plan, reachable, path)
    attach_csv_spectrum(path, "simulated_truth", truth_csv)
    attach_csv_spectrum(path, "sphere", sphere_csv)
    print(f"     stored in {path} ({path.stat().st_size / 1e6:.1f} MB)")


def _fit(path: Path) -> None:
    from gonio.fitting import fit

    scan = load(path)
    start = time.perf_counter()
    joint = fit(scan, aperture="exact", polarization="joint")
    duration_s = time.perf_counter() - start
    joint.save(path)
    for polarization in (
        "s",
        "p",
    ):  # the paper's Figure 12 shows n2 of S alone and P alone beside the joint one
        fit(scan, aperture="exact", polarization=polarization).save(path)
    print(f"3  Fit, S and P jointly, exact aperture: {readable_duration(duration_s)}\n")
    print(f"{fit_table(scan, joint)}\n\n{sphere_text(scan, joint)}")


def _facade(scene_file: Path, path: Path) -> None:
    from gonio.facade import load_scene, simulate

    path.unlink(missing_ok=True)
    scene = load_scene(scene_file)
    start = time.perf_counter()
    with progress_bar("facade", 1.0) as bar:
        irradiance = simulate(scene, rel_tol=0.01, progress=bar.update)
    irradiance.save(path)
    print(f"\n4  {scene.title}: {readable_duration(time.perf_counter() - start)}\n")
    print(irradiance.table())


def _report(scan_file: Path, facade_file: Path, folder: Path) -> Path:
    from gonio.report import write_report

    start = time.perf_counter()
    page = write_report(scan_file, folder, facade_h5=facade_file)
    print(f"\n5  Report with figures: {readable_duration(time.perf_counter() - start)}")
    return page


def _data(name: str) -> str:
    return resources.files("gonio").joinpath("data", name).read_text(encoding="utf-8")
