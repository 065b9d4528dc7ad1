"""Print the table of log relative errors: ``python -m tests.core.fit.nist`` from the repository's root."""

from .table import rows

print("matching digits        difficulty  solved as  start   value     se    rss")
for p, way, start, a in rows():
    mark = "" if a.converged else "  not converged"
    line = f"{p.name:<22}{p.difficulty:<12}{way:<11}{start + 1:>5}{a.value:>8.1f}{a.se:>7.1f}{a.rss:>7.1f}"
    print(line + mark)
