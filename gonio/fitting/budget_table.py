"""The printed budget of one wavelength: what was stated, what follows, and what was not stated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gonio.fitting.budget import Budget

_SHOWN = ("k_d", "k_s", "k_g", "alpha", "n2")


def budget_table(budget: Budget, k: int) -> str:
    """Return the budget at wavelength number k.

    One line per input: its standard uncertainty, how it was stated, and what it contributes to the standard
    uncertainty of each quantity; below, the sensitivities, the combined and the expanded uncertainty.
    """
    shown = [(q, name) for q, name in enumerate(budget.quantities) if name.partition("[")[0] in _SHOWN]
    width = 11 + max(0, *(len(name) - 7 for _, name in shown))
    nm = budget.fit.wavelength_nm[k]
    where = f"{nm:g} nm" if np.isfinite(nm) else f"wavelength {k}"
    head = f"{'input':<22}{'value':>10}{'u':>11} {'unit':<9}" + "".join(
        f"{name:>{width}}" for _, name in shown
    )
    lines = [
        f"uncertainty budget at {where}, k at {budget.theta_i_deg:g} deg: contributions to the standard "
        "uncertainty, with the sign that a larger value of the input has",
        head,
        "-" * len(head),
    ]

    def row(title: str, values: list[float], signed: bool = False) -> str:
        cells = "".join(f"{_number(value, signed):>{width}}" for value in values)
        return f"{title:<53}{cells}"

    stated = [(g, given) for g, given in enumerate(budget.inputs) if given.u is not None]
    for g, given in stated:
        title = f"{given.name:<22}{given.value:>10.6g}{given.u:>11.3g} {given.unit:<9}"
        cells = [float(budget.contribution[g, k, q]) for q, _ in shown]
        lines.append(row(title, [abs(x) for x in cells] if given.even else cells, not given.even))
    lines.append(row("noise of the readings", [float(budget.noise[k, q]) for q, _ in shown]))
    lines.append(
        row("baseline and dark readings of the scan", [float(budget.references[k, q]) for q, _ in shown])
    )
    if budget.fit.shared_names:
        lines.append(row("shared by the wavelengths", [float(budget.shared[k, q]) for q, _ in shown]))
    lines.append("-" * len(head))
    lines.append(row("combined standard uncertainty", [float(budget.combined[k, q]) for q, _ in shown]))
    lines.append(row("value", [float(budget.estimate[k, q]) for q, _ in shown]))
    lines.append(row("expanded uncertainty, 95 %", [float(budget.expanded[k, q]) for q, _ in shown]))
    lines.append(row("coverage factor", [float(budget.coverage[k, q]) for q, _ in shown]))
    lines.append("largest: " + ", ".join(f"{name} {budget.dominant(k, name)}" for _, name in shown))
    if stated:
        lines.append("sensitivity, change of the quantity per unit of the input:")
        for g, given in stated:
            if given.u and not given.even:
                cells = [float(budget.contribution[g, k, q] / given.u) for q, _ in shown]
                lines.append(row(f"  {given.name:<20}{'':>21} per {given.unit:<5}", cells, True))
    lines += [
        f"  {given.name}: {given.wording}" + (", even: root mean square of the effect" if given.even else "")
        for _, given in stated
    ]
    if budget.not_stated:
        lines.append(f"not stated in [uncertainty], taken as 0: {', '.join(budget.not_stated)}")
    return "\n".join(line.rstrip() for line in lines)


def _number(value: float, signed: bool) -> str:
    if np.isnan(value):
        return "?"
    return f"{value:+.2e}" if signed and value != 0.0 else f"{value:.4g}"
