"""How is a result printed?  Means, errors, what was left out, and the accounts of energy."""

from __future__ import annotations

from gonio.facade.result import CONTRIBUTIONS, Estimate, Irradiance

METHODS = {
    "rows": "transport rows and a linear solve for diffuse light, photons for lobes",
    "paths": "backward paths for diffuse light, photons for lobes",
    "backward": "everything by backward paths",
}


def table(irradiance: Irradiance) -> str:
    """Return the printed table of a result."""
    parts = [
        _means(irradiance),
        _errors(irradiance),
        _bands(irradiance),
        _omissions(irradiance),
        _accounts(irradiance),
        list(irradiance.notes),
    ]
    return "\n".join(line for part in parts for line in part)


def estimate_text(estimate: Estimate) -> str:
    """Return ``446.16 ± 3.40``, W/m2."""
    return f"{float(estimate.value):.2f} ± {float(estimate.standard_error):.2f}"


def _means(irradiance: Irradiance) -> list[str]:
    rows: list[tuple[str, ...]] = [("receiver", "total", *CONTRIBUTIONS)]
    for r in irradiance.receivers:
        cells = [r.mean, *(r.mean_contributions[c] for c in CONTRIBUTIONS)]
        rows.append((r.name, *(estimate_text(e) for e in cells)))
    return _aligned(rows)


def _errors(irradiance: Irradiance) -> list[str]:
    reached = "reached" if irradiance.converged else "NOT reached"
    lines = [
        f"W/m2, mean ± standard error; patches ± {100 * irradiance.relative_error:.2g} % "
        f"(rms, worst receiver; {100 * irradiance.rel_tol:g} % asked, {reached})"
    ]
    method = METHODS.get(irradiance.method, irradiance.method)
    lines.append(
        f"{irradiance.rays:.3g} rays in {irradiance.duration_s:.2f} s, seed {irradiance.seed}; {method}"
    )
    if irradiance.levels:
        lines.append(
            "materials: " + ", ".join(f"{name} {level}" for name, level in irradiance.levels.items())
        )
    if irradiance.interrupted:
        lines.append("INTERRUPTED: the points so far; gonio facade --resume goes on from here")
    return lines


def _bands(irradiance: Irradiance) -> list[str]:
    if not irradiance.bands:
        return []
    names = [r.name for r in irradiance.receivers]
    rows: list[tuple[str, ...]] = [("band / nm", "DNI", "DHI", *names)]
    rows += [
        (
            f"{b.low_nm:g}-{b.high_nm:g}",
            f"{b.dni_w_m2:.2f}",
            f"{b.dhi_w_m2:.2f}",
            *(estimate_text(b.means[n]) for n in names),
        )
        for b in irradiance.bands
    ]
    return ["by band, W/m2 (means):", *_aligned(rows)]


def _omissions(irradiance: Irradiance) -> list[str]:
    discretised = any(r.discretisation_w_m2 > 0.0 for r in irradiance.receivers)
    if not irradiance.omissions and not discretised:
        return []
    rows: list[tuple[str, ...]] = [("receiver", "W/m2", "%", "left out")]
    rows += [
        (o.receiver or "every", f"{o.bound_w_m2:.3g}", f"{o.bound_percent:.2g}", o.what)
        for o in irradiance.omissions
    ]
    for r in irradiance.receivers:
        if r.discretisation_w_m2 > 0.0:
            mean = max(float(r.mean.value), irradiance.floor_w_m2)
            percent = 100.0 * r.discretisation_w_m2 / mean if mean > 0.0 else 0.0
            bound = f"{r.discretisation_w_m2:.3g}"
            rows.append((r.name, bound, f"{percent:.2g}", "finite size of the patches"))
    name, error = irradiance.worst
    return [
        "bounds of what was left out:",
        *_aligned(rows, last_left=True),
        f"total error, {name}: {100 * error.statistical:.2g} % statistical (+) "
        f"{100 * error.omitted:.2g} % left out = {100 * error.total:.2g} % "
        f"({100 * irradiance.rel_tol:g} % asked)",
    ]


def _accounts(irradiance: Irradiance) -> list[str]:
    lines = []
    e = irradiance.energy
    if e.emitted_w > 0.0:
        handed = f"+ {e.handed_w:.6g} W handed to the diffuse exchange " if e.handed_w else ""
        lines.append(
            f"photons: {e.emitted_w:.6g} W in + {e.created_w:.3g} W created = "
            f"{e.absorbed_w:.6g} W absorbed ({e.under_horizon_w:.3g} W of it below the horizon) "
            f"+ {e.escaped_w:.6g} W escaped {handed}+ {e.unfinished_w:.3g} W unfinished; "
            f"balance {e.residual:.0e}"
        )
    x = irradiance.exchange
    if x is not None:
        lines.append(
            f"exchange: {x.emitted_w:.6g} W sent out diffusely = {x.received_w:.6g} W received "
            f"+ {x.escaped_w:.6g} W escaped, but for {x.difference_w:.2g} ± {x.standard_error_w:.2g} W; "
            f"residual of the solve {x.solver_residual:.0e}"
        )
    return lines


def _aligned(rows: list[tuple[str, ...]], *, last_left: bool = False) -> list[str]:
    """Return rows as lines, the first column left, the others right (the last left if it is text)."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(max(widths[0], 15))]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        if last_left:
            cells[-1] = row[-1]
        lines.append("  ".join(cells).rstrip())
    return lines
