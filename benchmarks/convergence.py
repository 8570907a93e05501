"""How fast the error falls with isolines, on scenes whose answer is a formula.

python benchmarks/convergence.py --output docs/convergence.md
"""

from __future__ import annotations

import argparse

import numpy as np
from common import markdown, write

import silint
from silint.reference.analytic_scenes import analytic_scenes

ISOLINES = (8, 16, 32, 64, 128, 256, 512)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", help="where to keep the table")
    options = parser.parse_args()
    cases = analytic_scenes()
    integrators = [silint.SilhouetteIntegrator(silint.Scene(c.vertices, c.faces)) for c in cases]
    worst = np.zeros((len(cases), len(ISOLINES)))
    for j, k in enumerate(ISOLINES):  # lines outside: their tables are built once
        for i, (case, integrator) in enumerate(zip(cases, integrators, strict=True)):
            for weighting in ("cosine", "uniform"):
                value = integrator.ambient_occlusion(case.points, case.normals, k, weighting)
                worst[i, j] = max(worst[i, j], np.abs(value - getattr(case, weighting)).max())
    rows = []
    for case, errors in zip(cases, worst, strict=True):
        inexact = errors > 1e-12
        slope = np.polyfit(np.log(ISOLINES), np.log(errors), 1)[0] if inexact.all() else None
        cells = [f"{e:.0e}" if e > 1e-12 else "exact" for e in errors]
        rows.append([case.name, *cells, "" if slope is None else f"{slope:.1f}"])
    header = ["largest error, cosine or uniform", *(str(k) for k in ISOLINES), "power of isolines"]
    write(options.output, markdown(header, rows))


if __name__ == "__main__":
    main()
